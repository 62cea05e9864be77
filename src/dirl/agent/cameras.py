"""A trained policy on features instead of view ids, as robots, simulators and ONNX need it."""

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.modules import GRU, LSTM, GRUModule, LSTMModule

from dirl.agent.agent import NEVER, four_of
from dirl.envs.transforms import VIEWS
from dirl.models import FeatureTable, initial_state, recurrent_keys
from dirl.models.belief import here_odds
from dirl.perception.backbones.patches import FINE_SHAPE
from dirl.perception.recognition.recogniser import (
    FRONT_THRESHOLD,
    ComparesPanoramas,
    Recogniser,
    ncc,
    panorama_odds,
)
from dirl.scenes import ACTIONS, Action


class Scores(NamedTuple):
    """The scores behind a decision; for a batch, tensors with a first dimension of ``B``."""

    matching: float | Tensor
    """Correlation of the agent's views with the goal's, in [-1, 1]; the agent stops above the threshold."""
    probabilities: Tensor
    """Probabilities of ahead, right, left and back, float32 ``[4]`` on the navigator's device."""


class Decision(NamedTuple):
    """The agent's action and whether it stops; for a batch, tensors ``[B]``."""

    action: Action | Tensor
    """0 ahead, 1 turn right, 2 turn left, 3 back, with its ``name``; take it unless ``stop`` is true."""
    stop: bool | Tensor
    """Whether the views match the goal's, that is, the agent has arrived."""
    scores: Scores


class FeaturePolicy(nn.Module):
    """A trained policy of one scene with template matching, on features instead of view ids.

    Args:
        policy: a `dirl.models.ActorCritic` with the layers of one scene; its table of features is not used.
        front: which of the four views is matched with the goal's; None to match all four.
    """

    def __init__(self, policy: Any, front: int | None) -> None:
        super().__init__()
        self.policy = policy
        self.front = front
        self.state_keys: list[str] = recurrent_keys(policy)
        """Keys of the recurrent state, in the order of arguments and results."""
        self.recurrent = _in_plain_operations(getattr(policy, "memory", None))

    @property
    def table(self) -> FeatureTable:
        """The table by which features are standardised."""
        table: FeatureTable = self.policy.features
        return table

    def forward(self, features: Tensor, goal_features: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        """Return action logits and the matching coefficient.

        Args:
            features: of the four views, as the backbone returns them, float32 ``[B, 4, D]``; if the encoder compares
                patches, these follow the pooled features.
            goal_features: of the goal's views, likewise. Unknown views are zeros: with one photo, all but the first.
            state: the recurrent state, ``[B, ...]`` each; zeros at the beginning of an episode.

        Returns:
            Logits ``[B, 4]``, value ``[B, 1]``, matching coefficient ``[B]``, and the next recurrent state.
        """
        logits, value, *after = self.decide(features, goal_features, *state)
        return logits, value, self.matching(features, goal_features), *after

    def decide(self, features: Tensor, goal_features: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        """Return logits, value and the next recurrent state; see `forward`."""
        # Not `len`: ONNX would then keep the number of agents of the trace, which is a free dimension.
        policy, scene = self.policy, torch.zeros(features.shape[0], dtype=torch.int64, device=features.device)
        encoded = policy.encoder(*self._read(features, goal_features))
        after: tuple[Tensor, ...] = ()
        if self.state_keys:
            encoded, after = self._remember(encoded, state)
        hidden = policy.heads.trunk(encoded, scene)
        return policy.heads.policy(hidden, scene), policy.heads.value(hidden, scene), *after

    def locate(self, features: Tensor, goal_features: Tensor) -> Tensor:
        """Return where the goals lie, facing each view, ``[B, 4, S, S]``; inputs as `forward`, and fine patches.

        See `dirl.models.locator.GoalLocator`.
        """
        patches: list[Tensor] = []
        if features.shape[-1] > (read := self.table.inputs):
            known = goal_features if goal_features[:, 1:].any() else goal_features[:, :1]
            patches = [of[..., read:].unflatten(-1, FINE_SHAPE) for of in (features, known)]
        located: Tensor = self.policy.locator(*self._read(features, goal_features), *patches)
        return located

    def _read(self, features: Tensor, goal_features: Tensor) -> tuple[Tensor, Tensor]:
        """Return features as the network reads them; views of a goal that are not known stay zeros."""
        table = self.policy.features
        features, goal_features = (of[..., : table.inputs] for of in (features, goal_features))
        known = (goal_features != 0).any(-1, keepdim=True)
        return table.standardise(features), torch.where(known, table.standardise(goal_features), 0.0)

    def matching(self, features: Tensor, goal_features: Tensor) -> Tensor:
        """Return the matching coefficient ``[B]``: of all views if the goal's are known, else of one; see `forward`."""
        whole = (goal_features[:, 1:] != 0).any(-1).any(1)
        # As in dirl.perception.recognition.recogniser, the pooled features are matched as the backbone gave them.
        pooled = len(self.table.mean)
        features, goal_features = features[..., :pooled], goal_features[..., :pooled]
        front = ncc(features[:, self.front or 0], goal_features[:, self.front or 0])
        if self.front is not None:
            return front
        return torch.where(whole, ncc(features.flatten(1), goal_features.flatten(1)), front)

    def describe(self, features: Tensor, recogniser: Recogniser) -> Tensor:
        """Return what a recogniser compares of views, ``[..., D]`` to ``[..., F]``.

        Fine patches, which the policy does not read, come last and are compared instead of the others.
        """
        table = self.table
        pooled, patches = len(table.mean), None
        if table.patches is not None:
            finest = features[..., table.inputs if features.shape[-1] > table.inputs else pooled :]
            patches = finest.unflatten(-1, (-1, table.patches.shape[-1]))
        return recogniser.describe(features[..., :pooled], patches)

    def _remember(self, encoded: Tensor, state: tuple[Tensor, ...]) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Take one step of the memory; return its output and the next state."""
        if self.recurrent is not None:
            layers = [part.transpose(0, 1) for part in state]
            output, after = self.recurrent(encoded.unsqueeze(1), layers[0] if len(layers) == 1 else tuple(layers))
            after = (after,) if isinstance(after, Tensor) else after
            return output.squeeze(1), tuple(part.transpose(0, 1) for part in after)
        known = dict(zip(self.state_keys, state, strict=True))
        began = torch.zeros((len(encoded), 1), dtype=torch.bool, device=encoded.device)
        row = TensorDict({"fused": encoded, "is_init": began, **known}, batch_size=[len(encoded)])
        row = self.policy.memory(row)
        return row["memory"], tuple(row["next", key] for key in self.state_keys)


def _in_plain_operations(memory: nn.Module | None) -> nn.Module | None:
    """Return the GRU or LSTM of TorchRL's module in operations that ONNX has for any batch size; None for others."""
    if isinstance(memory, GRUModule):
        kind, layers = GRU, memory.gru
    elif isinstance(memory, LSTMModule):
        kind, layers = LSTM, memory.lstm
    else:
        return None
    sizes = layers.input_size, layers.hidden_size, layers.num_layers
    plain: nn.Module = kind(*sizes, bias=layers.bias, batch_first=True)
    plain.load_state_dict(layers.state_dict())
    return plain.to(layers.weight_hh_l0.device).requires_grad_(False)


class Goal:
    """The goals of B agents, or one for all of them.

    Their views have features, float32 ``[B, 4, D]`` or ``[1, 4, D]``; of a single photo the last three views are zeros.
    """

    def __init__(self, policy: FeaturePolicy, recogniser: Recogniser, features: Tensor) -> None:
        self.policy, self.recogniser, self.features = policy, recogniser, features
        self.photo = not bool(features[:, 1:].any())
        self.described = policy.describe(features[:, :1] if self.photo else features, recogniser)

    def threshold(self, chosen: float) -> float:
        """Return the score above which agents stop: the recogniser's own, or the chosen one, raised for a photo."""
        own = self.recogniser.thresholds
        if own is not None:
            return own.photo if self.photo else own.views
        return max(chosen, FRONT_THRESHOLD) if self.photo and self.policy.front is None else chosen

    def matching(self, features: Tensor, chosen: Tensor | None = None) -> Tensor:
        """Return how much views ``[n, 4, D]`` look like the goals: score, or coefficient; see `scores`."""
        if self.recogniser.thresholds is None:
            return self.policy.matching(features, self.wanted(self.features, len(features), chosen))
        return self.scores(self.policy.describe(features, self.recogniser), chosen)

    def scores(self, visits: Tensor, chosen: Tensor | None = None) -> Tensor:
        """Return the scores of described visits ``[n, 4, F]`` with the agents' goals, ``[n]``.

        Each agent has equally many visits; ``chosen``, bool ``[B]``, leaves out agents that have none.
        """
        wanted = self.wanted(self.described, len(visits), chosen)
        return self.recogniser.scores(visits.unsqueeze(1), wanted.unsqueeze(1)).flatten()

    @staticmethod
    def wanted(goals: Tensor, rows: int, chosen: Tensor | None = None) -> Tensor:
        """Return the goals of so many rows, equally many for each chosen agent."""
        if len(goals) == 1:
            return goals.expand(rows, -1, -1)
        goals = goals if chosen is None else goals[chosen]
        return goals if len(goals) == rows else goals.repeat_interleave(rows // len(goals), 0)


class Views:
    """What B agents with cameras see now: the `dirl.agent.agent.Observed` that is computed.

    Args:
        goal: of the agents.
        features: of their K views, clockwise from the one ahead, float32 ``[B, K, D]``; four, or more in a panorama.
        threshold: above which they stop.
        state: of a recurrent policy; empty at the start of an episode.
        possible: which moves are possible facing each view, bool ``[B, K, 4]``; all if left out.
    """

    def __init__(
        self,
        goal: Goal,
        features: Tensor,
        threshold: float,
        state: tuple[Tensor, ...] = (),
        possible: Tensor | None = None,
    ) -> None:
        self.goal, self.features, self.threshold, self.state = goal, features, threshold, state
        self.points: Tensor | None = None
        """See `dirl.agent.agent.Observed`; the navigator matches them."""
        self.middles: Callable[[], Tensor | None] | None = None
        """In a panorama, features of the middle of each view, float32 ``[B, K, D]``; the navigator encodes them."""
        # Of a single agent with a goal of four views, by matched points: how clearly each arrow leads there, [K], and
        # the log odds that it is here, [K], corrected.
        self.bearing: Callable[[], Tensor] | None = None
        self.confirm: Callable[[Tensor], Tensor] | None = None
        self.arrows = None if possible is None else possible.expand(*features.shape[:2], -1)

    @cached_property
    def visit(self) -> Tensor:
        """The described views, float32 ``[B, K, F]``."""
        return self.goal.policy.describe(self.features, self.goal.recogniser)

    @property
    def pooled(self) -> Tensor:
        """Pooled features of the views, float32 ``[B, K, D]``."""
        return self.features[..., : len(self.goal.policy.table.mean)]

    @property
    def along(self) -> Tensor | None:
        """Pooled features of the middle of each view, where its arrow is, more or less."""
        middles = None if self.middles is None else self.middles()
        return None if middles is None else middles[..., : len(self.goal.policy.table.mean)]

    @property
    def toward(self) -> Tensor | None:
        """How clearly the arrow of each view leads to the goal, by points that are matched now."""
        return None if self.bearing is None else self.bearing().to(self.features.device)[None]

    @property
    def goal_pooled(self) -> Tensor:
        """Pooled features of the goals, ``[B, 4, D]``, or of photos ``[B, 1, D]``."""
        views = 1 if self.goal.photo else VIEWS
        goal = self.goal.features[:, :views, : self.pooled.shape[-1]]
        return goal.expand(len(self.features), -1, -1)

    @cached_property
    def matching(self) -> Tensor:
        """How much the agents' views look like their goals', ``[B]``."""
        return self.goal.matching(four_of(self.features))

    def alike(self, seen: Tensor) -> Tensor:
        """See `dirl.agent.agent.Observed`, as all below."""
        return compare(self.goal.recogniser, seen, self.visit)

    def logits(self) -> Tensor:
        """Return the policy's logits and advance its state: call this once a step."""
        policy, wanted = self.goal.policy, self.goal.wanted(self.goal.features, len(self.features))
        state = self.state or initial_state(policy.policy, len(self.features), self.features.device).values()
        logits, _, *after = policy.decide(four_of(self.features), wanted, *state)
        self.state = tuple(after)
        return logits if self.arrows is None else logits.masked_fill(~self.arrows[:, 0], NEVER)

    def facing(self, chosen: Tensor) -> Tensor:
        """Return the chosen agents' logits, facing each view; zero for others."""
        headings = self.features.shape[1]
        logits = self.features.new_zeros(len(chosen), headings, len(ACTIONS))
        if chosen.any():
            views = each_heading(self.features[chosen])
            asked = self.goal.policy.decide(views, self.goal.wanted(self.goal.features, len(views), chosen))[0]
            logits[chosen] = asked.unflatten(0, (-1, headings))
        return logits

    @property
    def inputs(self) -> Tensor:
        """The features of the views."""
        return self.features

    def displacement(self, earlier: Tensor | None = None) -> Tensor | None:
        """Return where the goals lie, or the places of earlier visits, facing each view."""
        return self._located if earlier is None else self._locate(earlier)

    def place_odds(self) -> Tensor | None:
        """Return the log odds that the agents are at their goals' places; only fine patches tell them well."""
        fine = self.features.shape[-1] > self.goal.policy.table.inputs
        return here_odds(self._located) if fine and self._located is not None else None

    @cached_property
    def _located(self) -> Tensor | None:
        return self._locate(self.goal.wanted(self.goal.features, len(self.features)))

    def _locate(self, wanted: Tensor) -> Tensor | None:
        policy = self.goal.policy
        if policy.policy.locator is None or self.features.shape[1] > VIEWS:
            return None
        return policy.locate(self.features, wanted)

    def at_goal(self) -> Tensor:
        """Return True where agents stop."""
        return self.matching > self.threshold

    def goal_around(self, chosen: Tensor) -> Tensor:
        """Return True where the chosen agents would stop, facing each view; False for others."""
        headings = self.features.shape[1]
        stops = chosen.new_zeros(len(chosen), headings)
        if chosen.any():
            matching = self.goal.matching(each_heading(self.features[chosen]), chosen)
            stops[chosen] = matching.unflatten(0, (-1, headings)) > self.threshold
        return stops

    @property
    def photo(self) -> bool:
        """Whether the goals are photos."""
        return self.goal.photo

    def confirmed(self, odds: Tensor) -> Tensor:
        """Return the log odds that the goal is seen, corrected by points where the navigator matches them."""
        return odds if self.confirm is None else self.confirm(odds[0].cpu()).to(odds.device)[None]

    def goal_odds(self, visits: Tensor, place: Tensor) -> Tensor:
        """Return the log odds that visits see the goal facing each view."""
        recogniser = self.goal.recogniser
        if visits.shape[2] > VIEWS and isinstance(recogniser, ComparesPanoramas) and not self.goal.photo:
            wanted = recogniser.whole(self.goal.described).expand(len(visits), -1, -1)
            return panorama_odds(recogniser.whole(visits), wanted, recogniser.whole(place))
        return self.goal.scores(each_heading(visits.flatten(0, 1))).view(*visits.shape[:3])


def compare(recogniser: Recogniser, seen: Tensor, visit: Tensor) -> Tensor:
    """Return scores of described visits ``[B, K, F]`` with earlier ones, ``[B, T, K, F]``, facing each of their views.

    An agent that turned right since a visit sees the same views rolled by minus one: rolled back they are alike. Of a
    panorama each four views, 90 degrees apart, are compared, and the mean is taken, unless the recogniser
    `ComparesPanoramas`.
    """
    between = visit.shape[1] // VIEWS
    if between > 1 and isinstance(recogniser, ComparesPanoramas):
        return panorama_odds(recogniser.whole(seen), recogniser.whole(visit))
    rings = []
    for ring in range(between):
        facing = torch.stack([four_of(visit.roll(-ring, 1)).roll(quarters, 1) for quarters in range(VIEWS)], 1)
        turned = seen.roll(-ring, 2)
        # What is seen now comes first, as in a world's table: a learned recogniser need not be symmetric.
        scores = [recogniser.scores(facing, turned[:, :, first::between]).mT for first in range(between)]
        rings.append(torch.stack(scores, -1).flatten(-2))
    return torch.stack(rings).mean(0) if between > 1 else rings[0]


def each_heading(views: Tensor) -> Tensor:
    """Return what agents see that face each of their K views, ``[B, K, D]`` to ``[K B, 4, D]``."""
    return torch.stack([four_of(views.roll(-turns, 1)) for turns in range(views.shape[1])], 1).flatten(0, 1)

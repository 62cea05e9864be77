"""A trained policy on features instead of view ids, as a robot and ONNX need it."""

from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.modules import GRU, LSTM, GRUModule, LSTMModule

from dirl.models import recurrent_keys
from dirl.recognition.matching import ncc


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
        """Of the recurrent state, in the order of arguments and results."""
        self.recurrent = _in_plain_operations(getattr(policy, "memory", None))

    def forward(self, features: Tensor, goal_features: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        """Action logits and matching coefficient.

        Args:
            features: of the four views, as the backbone returns them, float32 ``[B, 4, D]``; if the encoder compares
                patches, these follow the pooled features.
            goal_features: of the goal's views, likewise. Unknown views are zeros: with one photo, all but the first.
            state: the recurrent state, ``[B, ...]`` each; zeros at the beginning of an episode.

        Returns:
            Logits ``[B, 4]``, value ``[B, 1]``, matching coefficient ``[B]``, and the next recurrent state.
        """
        # Not `len`: ONNX would then keep the number of agents of the trace, which is a free dimension.
        policy, scene = self.policy, torch.zeros(features.shape[0], dtype=torch.int64, device=features.device)
        known = (goal_features != 0).any(-1, keepdim=True)
        goal = torch.where(known, policy.features.standardise(goal_features), 0.0)
        encoded = policy.encoder(policy.features.standardise(features), goal)
        after: tuple[Tensor, ...] = ()
        if self.state_keys:
            encoded, after = self._remember(encoded, state)
        hidden = policy.heads.trunk(encoded, scene)
        matching = self._matching(features, goal_features, known[:, 1:].any(1).squeeze(-1))
        return policy.heads.policy(hidden, scene), policy.heads.value(hidden, scene), matching, *after

    def _matching(self, features: Tensor, goal_features: Tensor, whole: Tensor) -> Tensor:
        """The coefficient ``[B]``: of all views if the goal's are known (``whole``, bool ``[B]``), else of one."""
        # As in dirl.recognition.matching, the pooled features are matched as the backbone gave them.
        pooled = len(self.policy.features.mean)
        features, goal_features = features[..., :pooled], goal_features[..., :pooled]
        front = ncc(features[:, self.front or 0], goal_features[:, self.front or 0])
        if self.front is not None:
            return front
        return torch.where(whole, ncc(features.flatten(1), goal_features.flatten(1)), front)

    def _remember(self, encoded: Tensor, state: tuple[Tensor, ...]) -> tuple[Tensor, tuple[Tensor, ...]]:
        """One step of the memory: its output, and the next state."""
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
    """The GRU or LSTM of TorchRL's module, in operations that ONNX has for any number of agents; None for others."""
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

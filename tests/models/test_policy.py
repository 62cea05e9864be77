"""The policy of figure 2: encoder, layers of each scene, operators, and an optional memory."""

import pytest
import torch
from networks import SCENES, SURROUNDING, batch_of, make_policy, seen, standardised_policy
from torch import nn
from torchrl.modules import set_recurrent_mode

from dirl.models import ActorCriticHeads, initial_state, plain_weights, recurrent_keys
from dirl.models import policy as policy_module
from dirl.models.policy import SceneLinear, SceneTrunks

OUTPUTS = ("hidden", "logits", "state_value")


@pytest.mark.parametrize("cached", [False, True])
def test_torchrls_operators_compute_what_the_network_computes(cached):
    policy, given = standardised_policy(), batch_of(*seen())
    expected = policy(given.copy())
    if cached:
        policy.cache(SURROUNDING)
    calls = []
    policy.encoder.embedding.register_forward_hook(lambda *_: calls.append(1))
    out = policy.operator()(given)
    for key in ("logits", "state_value"):
        torch.testing.assert_close(out[key], expected[key])
    chosen = expected["logits"].log_softmax(-1).gather(-1, out["action"].unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(out["action_log_prob"], chosen)
    assert len(calls) == 2  # once for observations, once for goals


def test_its_plain_weights_are_those_without_what_makes_it_fast():
    policy = standardised_policy()
    expected = {name: value.clone() for name, value in policy.state_dict().items()}
    policy.cache(SURROUNDING)
    found = plain_weights(policy)
    assert found.keys() == expected.keys()
    torch.testing.assert_close(found, expected)


def walked(policy, steps, begins):
    """Step by step: what a policy with memory writes for ``[B, T]``, and the batch as a rollout would hold it."""
    batch, outputs = [], []
    state = initial_state(policy, len(begins), torch.device("cpu"))
    for time in range(steps):
        views, goal_views, scene = seen(seed=time, rows=len(begins))
        state = {key: value.where(~begins[:, time, None, None], 0) for key, value in state.items()}  # as a primer does
        given = batch_of(views, goal_views, scene % 2).update({"is_init": begins[:, time : time + 1], **state})
        batch.append(given.copy())
        outputs.append(policy(given).select(*OUTPUTS))
        state = {key: given["next", key] for key in recurrent_keys(policy)}
    return torch.stack(batch, 1), torch.stack(outputs, 1)


def test_a_memory_makes_of_whole_episodes_what_it_makes_step_by_step():
    remembering = standardised_policy(memory=True)
    remembering.cache(SURROUNDING)
    begins = torch.zeros(6, 9, dtype=torch.bool)
    begins[:, 0] = True
    begins[1, 4] = begins[3, 1] = begins[3, 2] = begins[5, 8] = True
    batch, stepped = walked(remembering, 9, begins)
    with set_recurrent_mode(True):
        whole = remembering(batch)
    for key in OUTPUTS:
        torch.testing.assert_close(whole[key], stepped[key])


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("layers", [kind(SCENES, lambda: nn.Linear(5, 3)) for kind in (SceneTrunks, SceneLinear)])
@pytest.mark.parametrize("scene", [[2, 0, 1, 0, 2, 2], [1, 1, 1, 1, 1, 1], [2, 0, 0, 2, 0, 2]])
def test_each_row_goes_through_the_layer_of_its_scene(layers, scene, late, monkeypatch):
    monkeypatch.setattr(policy_module, "reading_waits", lambda tensor: late)  # as on a GPU, or not
    layers.sorts = True
    rows = torch.randn(6, 5)
    expected = torch.stack([layers.scenes[SCENES[s]](row) for row, s in zip(rows, scene, strict=True)])
    torch.testing.assert_close(layers(rows, torch.tensor(scene)), expected)


def test_weights_carry_the_names_of_scenes_and_are_as_many_as_published():
    made = make_policy(torch.zeros(1, 2048), ["a", "b", "c", "d"], width=512)
    assert sum(value.numel() for value in made.parameters()) == 5_780_500
    assert "value.scenes.kitchen.weight" in ActorCriticHeads(SCENES, 5, 4, 3).state_dict()
    assert "scenes.v1_0.weight" in SceneTrunks(["v1.0"], lambda: nn.Linear(1, 1)).state_dict()

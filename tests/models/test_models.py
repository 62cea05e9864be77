import copy
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict
from torch import nn

from dirl.models import FeatureTable, actor_critic, count_parameters, feature_statistics, make_network
from dirl.models.fast.caching import Memory, pack, unpack
from dirl.models.heads import SceneHeads, SceneLayers
from dirl.objectives import TFRMSprop

STATES, FEATURES, WIDTH, SCENES = 30, 7, 12, ("bath", "bed", "kitchen")
# What is seen from each state: first the state itself.
SURROUNDING = torch.randint(STATES, (STATES, 4), generator=torch.Generator().manual_seed(9))
SURROUNDING[:, 0] = torch.arange(STATES)


@pytest.fixture
def network():
    features = torch.randn(STATES, FEATURES, generator=torch.Generator().manual_seed(0)) * 3 + 1
    return make_network(features, SCENES, statistics=feature_statistics(features), width=WIDTH, seed=1)


def seen(seed=0, rows=80):
    """Views, goal views and scenes of agents, many of whom see the same, some of them another's goal."""
    generator = torch.Generator().manual_seed(seed)
    kinds = SURROUNDING[torch.randperm(STATES, generator=generator)[:12]]
    views, goal_views = (kinds[first + torch.randint(8, (rows,), generator=generator)] for first in (0, 4))
    return views, goal_views, torch.randint(len(SCENES), (rows,), generator=generator)


def direct(encoder, views, goal_views):
    """The paper's form: every row embedded by itself, the embeddings concatenated and fused."""
    return encoder.fuse(encoder.embed(encoder.table(views)), encoder.embed(encoder.table(goal_views)))


def gradients(module, output):
    module.zero_grad()
    weights = torch.linspace(-1, 1, output.numel()).view_as(output)
    (output * weights).sum().backward()
    return [parameter.grad for parameter in module.parameters()]


def embedded_rows(encoder):
    """A list that takes down how many rows each call of the embedding layer gets."""
    calls = []
    encoder.embedding.register_forward_hook(lambda module, inputs, output: calls.append(len(inputs[0])))
    return calls


def test_encoder_equals_the_direct_form(network):
    views, goal_views, _ = seen()
    fused = network.encoder(views, goal_views)
    assert fused.shape == (80, WIDTH)
    torch.testing.assert_close(fused, direct(network.encoder, views, goal_views))


def test_encoder_gradients_equal_those_of_the_direct_form(network):
    views, goal_views, _ = seen()
    found = gradients(network.encoder, network.encoder(views, goal_views))
    torch.testing.assert_close(found, gradients(network.encoder, direct(network.encoder, views, goal_views)))


def test_encoder_embeds_each_distinct_row_once(network):
    views, goal_views, _ = seen()
    calls = embedded_rows(network.encoder)
    network.encoder(views, goal_views)
    assert sum(calls) <= len(views.unique(dim=0)) + len(goal_views.unique(dim=0)) == 16


def test_observation_and_goal_are_embedded_by_the_same_weights(network):
    views, goal_views, _ = seen()
    swapped = copy.deepcopy(network.encoder)
    with torch.no_grad():
        swapped.fusion.weight.copy_(network.encoder.fusion.weight.roll(WIDTH, 1))
    torch.testing.assert_close(swapped(goal_views, views), network.encoder(views, goal_views))
    assert [name for name, _ in swapped.named_parameters()] == [
        "embedding.weight", "embedding.bias", "fusion.weight", "fusion.bias"
    ]  # fmt: skip


def in_axes(network, kind):
    """A copy of the network that computes in principal axes; with ``every``, as on a GPU."""
    changed = copy.deepcopy(network)
    changed.encoder.use_principal_axes(None if kind == "any four views" else SURROUNDING)
    if kind == "every":
        changed.encoder._recall = lambda: (Memory(STATES), Memory(STATES))
    return changed


@pytest.mark.parametrize("kind", ["surrounding", "any four views", "every"])
def test_principal_axes_change_the_weights_but_not_what_they_compute(network, kind):
    changed, (views, goal_views, _) = in_axes(network, kind), seen()
    if kind == "any four views":
        views = views.flip(0).roll(1, 1)
    else:
        views = views * torch.tensor([1, 0, 0, 0])  # the state alone says what is seen from it
    whole = SURROUNDING[views[:, 0]] if kind != "any four views" else views
    fused, plain = changed.encoder(views, goal_views), network.encoder(whole, goal_views)
    torch.testing.assert_close(fused, plain)
    found, expected = gradients(changed.encoder, fused), gradients(network.encoder, plain)
    # W = C V', so the gradient of C is that of W in the axes.
    torch.testing.assert_close(found[0], changed.encoder.axes.narrow(expected[0]))
    torch.testing.assert_close(found[1:], expected[1:])
    torch.testing.assert_close(changed.weights_on_features(), network.state_dict())


def test_principal_axes_need_no_more_columns_than_the_features_span(network):
    columns = {kind: in_axes(network, kind).encoder.embedding.in_features for kind in ("surrounding", "any four views")}
    assert columns == {"surrounding": 4 * FEATURES, "any four views": 4 * FEATURES}  # 30 states span all 28
    few = make_network(torch.randn(3, FEATURES), SCENES, width=WIDTH)
    few.encoder.use_principal_axes(torch.tensor([[0, 1, 2, 0], [1, 2, 0, 1], [2, 0, 1, 2]]))
    assert few.encoder.embedding.in_features == 3
    few.encoder.use_features()
    few.encoder.use_principal_axes(None)
    assert few.encoder.embedding.in_features == 4 * 3


def test_what_was_learnt_in_principal_axes_stays_on_features(network):
    changed, (views, goal_views, _) = in_axes(network, "surrounding"), seen()
    beside = torch.randn(4 * FEATURES, generator=torch.Generator().manual_seed(3))
    few = make_network(torch.randn(3, FEATURES), SCENES, width=WIDTH)
    before = few.encoder.embedding.weight.detach().clone()
    few.encoder.use_principal_axes(torch.tensor([[0, 1, 2, 0], [1, 2, 0, 1], [2, 0, 1, 2]]))
    rows = few.encoder.axes.features[few.encoder.axes.surrounding].flatten(-2)
    beside -= torch.linalg.lstsq(rows.T, beside).solution @ rows
    for encoder in (changed.encoder, few.encoder):
        with torch.no_grad():
            encoder.embedding.weight.add_(0.1 * torch.randn_like(encoder.embedding.weight))
    fused = changed.encoder(views, goal_views)
    changed.encoder.use_features()
    torch.testing.assert_close(direct(changed.encoder, views, goal_views), fused)
    # Nothing was learnt of what the states never show.
    few.encoder.use_features()
    torch.testing.assert_close(few.encoder.embedding.weight @ beside, before @ beside, atol=1e-5, rtol=1e-4)


def test_remembering_gives_the_same_output_and_gradients_after_a_rollout(network):
    encoder, (views, goal_views, _) = network.encoder, seen()
    more_views, more_goal_views, _ = seen(seed=1)
    plain = encoder(torch.cat([views, more_views]), torch.cat([goal_views, more_goal_views]))
    plain_gradients = gradients(encoder, plain)
    with encoder.remembering():
        with torch.no_grad():
            for half in (slice(40), slice(40, None)):
                rollout = encoder(views[half], goal_views[half])
                torch.testing.assert_close(rollout, plain[:80][half])
        # The loss sees what the rollout saw and something new.
        again = encoder(torch.cat([views, more_views]), torch.cat([goal_views, more_goal_views]))
    torch.testing.assert_close(again, plain)
    torch.testing.assert_close(gradients(encoder, again), plain_gradients)


def test_remembering_embeds_no_observation_twice(network):
    views, goal_views, _ = seen()
    calls = embedded_rows(network.encoder)
    with network.encoder.remembering():
        with torch.no_grad():
            network.encoder(views[:3], goal_views[:3])
            network.encoder(views, goal_views)
        network.encoder(views, goal_views)
        network.encoder(goal_views, views)
    assert sum(calls) <= len(views.unique(dim=0)) + len(goal_views.unique(dim=0)) == 16


@pytest.mark.parametrize("optimiser", [torch.optim.Adam, TFRMSprop])
def test_remembering_forgets_what_older_weights_embedded(network, optimiser):
    encoder, (views, goal_views, _) = network.encoder, seen()
    optimiser = optimiser(encoder.parameters(), lr=0.1)
    with encoder.remembering():
        for _ in range(2):
            with torch.no_grad():
                encoder(views, goal_views)
            fused = encoder(views, goal_views)
            torch.testing.assert_close(fused, direct(encoder, views, goal_views))
            gradients(encoder, fused)
            optimiser.step()


@pytest.mark.parametrize("context", ["remembering", "projecting"])
def test_after_the_context_the_weights_count_again(network, context):
    encoder, (views, goal_views, _) = network.encoder, seen()

    def leave_by_an_error():
        with torch.no_grad(), getattr(encoder, context)():
            encoder(views, goal_views)
            raise KeyError

    with pytest.raises(KeyError):
        leave_by_an_error()
    calls = embedded_rows(encoder)
    encoder(views, goal_views)
    assert calls, "the context still answers"
    with torch.no_grad():
        encoder.embedding.weight.add_(1)
        for manager in (torch.no_grad(), getattr(encoder, context)()):
            with manager:
                torch.testing.assert_close(encoder(views, goal_views), direct(encoder, views, goal_views))


def test_projecting_gives_the_same_output_without_the_embedding(network):
    views, goal_views, _ = seen()
    plain = network.encoder(views, goal_views)
    calls = embedded_rows(network.encoder)
    with network.encoder.projecting():
        projected = network.encoder(views, goal_views)
    torch.testing.assert_close(projected, plain)
    assert calls == []


def small_layers(scenes):
    return SceneLayers(scenes, lambda: nn.Linear(5, 3)), SceneHeads(scenes, 5, 3)


@pytest.mark.parametrize("layers", small_layers(SCENES))
@pytest.mark.parametrize("scene", [[2, 0, 1, 0, 2, 2], [1, 1, 1, 1, 1, 1], [2, 0, 0, 2, 0, 2]])
def test_each_row_goes_through_the_layer_of_its_scene(layers, scene):
    rows = torch.randn(6, 5)
    expected = torch.stack([layers.scenes[SCENES[s]](row) for row, s in zip(rows, scene, strict=True)])
    torch.testing.assert_close(layers(rows, torch.tensor(scene)), expected)


@pytest.mark.parametrize("layers", small_layers(SCENES))
def test_gradients_do_not_leak_into_other_scenes(layers):
    scene = torch.tensor([2, 0, 0, 2, 1])
    layers(torch.randn(5, 5), scene)[scene == 2].square().sum().backward()
    assert layers.scenes["kitchen"].weight.grad.abs().sum() > 0
    for name in ("bath", "bed"):
        assert layers.scenes[name].weight.grad.abs().sum() == 0
        assert layers.scenes[name].bias.grad.abs().sum() == 0


@pytest.mark.parametrize("layers", small_layers(["shared"]))
def test_layers_of_one_name_serve_every_scene(layers):
    rows = torch.randn(4, 5)
    assert torch.equal(layers(rows, torch.tensor([0, 3, 1, 2])), layers.scenes["shared"](rows))


def test_a_scenes_weights_carry_its_name(network):
    assert "value.scenes.kitchen.weight" in network.state_dict()
    assert "scenes.v1_0.weight" in SceneLayers(["v1.0"], lambda: nn.Linear(1, 1)).state_dict()


def test_network_puts_two_heads_on_a_layer_of_the_scene(network):
    views, goal_views, scene = seen(rows=20)
    logits, value = network(views, goal_views, scene)
    fused = direct(network.encoder, views, goal_views)
    for row, s in enumerate(scene):
        name = SCENES[s]
        hidden = network.hidden.scenes[name][0](fused[row]).relu()
        torch.testing.assert_close(logits[row], network.policy.scenes[name](hidden))
        torch.testing.assert_close(value[row], network.value.scenes[name](hidden))
    assert logits.shape == (20, 4)
    assert value.shape == (20, 1)


def test_torchrls_operators_compute_what_the_network_computes(network):
    views, goal_views, scene = seen()
    logits, value = network(views, goal_views, scene)
    calls = embedded_rows(network.encoder)
    given = TensorDict({"views": views, "goal_views": goal_views, "scene": scene}, [80])
    out = actor_critic(network)(given)
    torch.testing.assert_close(out["logits"], logits)
    torch.testing.assert_close(out["state_value"], value)
    chosen = logits.log_softmax(-1).gather(-1, out["action"].unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(out["action_log_prob"], chosen)
    assert len(calls) == 1


def test_a_network_is_decided_by_its_seed_alone():
    features = torch.rand(5, 3)
    made = []
    for torchs_seed, seed in ((0, 7), (1, 7), (1, 8)):
        torch.manual_seed(torchs_seed)
        made.append(make_network(features, SCENES, width=4, seed=seed).state_dict())
        drawn = torch.rand(1)
        torch.manual_seed(torchs_seed)
        assert torch.rand(1) == drawn, "making a network disturbed torch's own generator"
    assert all(torch.equal(made[0][key], made[1][key]) for key in made[0])
    assert not torch.equal(made[0]["encoder.embedding.weight"], made[2]["encoder.embedding.weight"])


def test_the_published_network_has_its_number_of_parameters():
    assert count_parameters(make_network(torch.zeros(1, 2048), ["a", "b", "c", "d"])) == 5_780_500


def test_shared_heads_are_one_scenes_heads():
    shared = make_network(torch.zeros(1, FEATURES), SCENES, heads="shared", width=WIDTH)
    single = make_network(torch.zeros(1, FEATURES), SCENES[:1], width=WIDTH)
    assert count_parameters(shared) == count_parameters(single)


def test_frozen_parameters_are_not_counted(network):
    before = count_parameters(network)
    network.encoder.fusion.weight.requires_grad_(False)
    assert count_parameters(network) == before - 2 * WIDTH * WIDTH


def test_weights_and_biases_start_within_one_over_the_root_of_fan_in():
    network = make_network(torch.zeros(1, 64), SCENES, width=64)
    layers = [module for module in network.modules() if isinstance(module, nn.Linear)]
    assert len(layers) == 2 + 3 * len(SCENES)
    for layer in layers:
        bound = 1 / math.sqrt(layer.in_features)
        for values in (layer.weight, layer.bias):
            assert values.abs().max() <= bound
        assert layer.weight.abs().max() > 0.9 * bound
    biases = torch.cat([layer.bias * math.sqrt(layer.in_features) for layer in layers])
    assert biases.abs().max() > 0.9


def test_the_state_dict_keeps_mean_and_deviation_but_not_the_table(network):
    assert sorted(network.encoder.table.state_dict()) == ["mean", "std"]


def test_a_loaded_network_standardises_as_the_one_that_was_saved(network):
    fresh = make_network(network.encoder.table.features, SCENES, width=WIDTH)
    fresh.load_state_dict(network.state_dict())
    torch.testing.assert_close(fresh(*seen()), network(*seen()))


def test_features_are_standardised_dimension_by_dimension():
    features = torch.tensor([[1.0, 5.0], [3.0, 5.0], [5.0, 5.0]])
    mean, std = feature_statistics(features)
    # The second feature never changes: its deviation is taken as one.
    assert mean.tolist() == [3, 5]
    assert std.tolist() == [2, 1]
    table = FeatureTable(features, mean, std)
    assert table(torch.tensor([[2, 0]])).tolist() == [[[1, 0], [-1, 0]]]
    assert (len(table), table.width) == (3, 2)
    assert torch.equal(FeatureTable(features)(torch.arange(3)), features)


@given(st.lists(st.lists(st.integers(0, 55_107), min_size=4, max_size=4), min_size=1, max_size=20))
def test_packed_rows_unpack_to_themselves(rows):
    views = torch.tensor(rows)
    keys = pack(views, 55_108)
    assert torch.equal(unpack(keys, 55_108, 4), views)
    assert len(keys.unique()) == len({tuple(row) for row in rows})


def test_too_large_a_world_is_refused():
    with pytest.raises(ValueError, match="55109 states is too large"):
        pack(torch.zeros(1, 4, dtype=torch.int64), 55_109)


@pytest.mark.parametrize("every", [None, 41])
@given(questions=st.lists(st.lists(st.integers(0, 40), min_size=1, max_size=10), min_size=1, max_size=6))
def test_memory_gives_each_keys_row_and_computes_none_twice(every, questions):
    memory, computed = Memory(every), []

    def square(keys):
        computed.extend(keys.tolist())
        return ((keys**2).float().unsqueeze(-1),)

    for question in questions:
        places = memory.places(torch.tensor(question), square)
        assert memory.keys[places].tolist() == question
        assert memory.rows[0][places].squeeze(-1).tolist() == [key**2 for key in question]
    assert sorted(computed) == (list(range(41)) if every else sorted(set().union(*questions)))

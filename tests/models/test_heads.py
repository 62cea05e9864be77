import pytest
import torch
from networks import SCENES
from torch import nn

from dirl.models import ActorCriticHeads, policy
from dirl.models.policy import SceneLinear, SceneTrunks


def small_layers(scenes):
    return SceneTrunks(scenes, lambda: nn.Linear(5, 3)), SceneLinear(scenes, 5, 3)


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("layers", small_layers(SCENES))
@pytest.mark.parametrize("scene", [[2, 0, 1, 0, 2, 2], [1, 1, 1, 1, 1, 1], [2, 0, 0, 2, 0, 2]])
def test_each_row_goes_through_the_layer_of_its_scene(layers, scene, late, monkeypatch):
    monkeypatch.setattr(policy, "reading_waits", lambda tensor: late)  # as on a GPU, or not
    layers.sorts = True
    rows = torch.randn(6, 5)
    expected = torch.stack([layers.scenes[SCENES[s]](row) for row, s in zip(rows, scene, strict=True)])
    torch.testing.assert_close(layers(rows, torch.tensor(scene)), expected)


@pytest.mark.parametrize("layers", small_layers(["shared"]))
def test_layers_of_one_name_serve_every_scene(layers):
    rows = torch.randn(4, 5)
    assert torch.equal(layers(rows, torch.tensor([0, 3, 1, 2])), layers.scenes["shared"](rows))


def test_a_scenes_weights_carry_its_name():
    assert "value.scenes.kitchen.weight" in ActorCriticHeads(SCENES, 5, 4, 3).state_dict()
    assert "scenes.v1_0.weight" in SceneTrunks(["v1.0"], lambda: nn.Linear(1, 1)).state_dict()


@pytest.mark.parametrize("make", [lambda names: SceneLinear(names, 2, 2), lambda names: ActorCriticHeads(names, 2, 2)])
def test_names_that_differ_only_in_dots_and_underscores_are_refused(make):
    with pytest.raises(ValueError, match="must differ by more than dots and underscores"):
        make(["v1.0", "v1_0"])

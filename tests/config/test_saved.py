import pytest
import torch
from commands import room_file, train_config
from parts import make_parts

from dirl.agent.images import NavigatorError
from dirl.agent.loading import rebuild
from dirl.config.saved import MAX_CHARACTERS, config_text, read_config
from dirl.config.schemas import ConfigError
from dirl.models import plain_weights
from dirl.training.load import load_trained


def refusal(*arguments, **options):
    with pytest.raises(ConfigError) as raised:
        read_config(*arguments, **options)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_a_saved_configuration_is_read_back_and_can_be_changed():
    config = train_config("scene=bathroom_02", "imitation.rule=interval")
    text = config_text(config)
    read = read_config(text, "here")
    read.trust = None
    assert read == config
    changed = read_config(text, "here", {"stop.threshold": 0.8, "goals": [51]})
    assert (changed.stop.threshold, changed.goals) == (0.8, [51])


def test_what_it_was_started_with_is_not_saved():
    config = train_config("scene=bathroom_02", "trust=[os]")
    assert config.trust == ["os"]
    assert read_config(config_text(config), "here").trust == []
    assert read_config(config_text(config) + "\n", "here", trust=["mine"]).trust == ["mine"]


WRONG = ["scene: [", "colour: red", "seed: many", "seed: -1", "", "3", "- 1", "1: 2"]
WRONG += ["losses: 5", "losses: [a2c]", "seed: !!timestamp x", "seed: !!binary x", "imitation: 5"]


@pytest.mark.parametrize("text", WRONG)
def test_what_is_no_configuration_names_where_it_stood(text):
    told = refusal(text, "here/config.yaml")
    assert told.startswith("here/config.yaml: holds no configuration of this version")


def text():
    return config_text(train_config("scene=bathroom_02"))


def test_interpolations_are_not_resolved():
    for wrong in ("${oc.env:HOME}", "${seed}", "a ${run_folder:a,b,c,d}"):
        assert "${...}" in refusal(text().replace("project: dirl", f"project: '{wrong}'"), "here")


def test_aliases_are_refused():
    assert "YAML aliases" in refusal("a: &a [x]\nb: *a\n" + text(), "here")
    bomb = "a: &a [x,x]\n" + "".join(f"{b}: &{b} [*{a},*{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))
    assert "YAML aliases" in refusal(bomb, "here")


def test_a_huge_text_is_not_read():
    told = refusal(text() + "#" * MAX_CHARACTERS, "here")
    assert f"at most {MAX_CHARACTERS} are read" in told


def test_python_objects_are_refused():
    refusal("scene: !!python/object/apply:os.system ['true']", "here")


def test_deep_nesting_is_refused():
    refusal("scene: " + "[" * 5000, "here")


@pytest.mark.parametrize("target", ["os.system", "builtins.eval", "torch.load", "pathlib.Path"])
def test_it_builds_dirls_own_classes_only(target):
    wrong = text().replace("dirl.models.SiameseEncoder", target)
    assert f"trust=[{target.split('.')[0]}]" in refusal(wrong, "here")


@pytest.mark.parametrize("std", [torch.ones(7), torch.ones(()), torch.ones(2, 2)])
def test_statistics_of_another_width_are_refused_in_one_line(tmp_path, std):
    room = room_file(tmp_path)
    parts = make_parts(f"scene={room}", "encoder.width=8", "heads.width=8")
    saved = {"network": {**plain_weights(parts.policy), "features.std": std}, "config": config_text(parts.config)}
    saved |= {"extractor": parts.world.scenes[0].extractor, "frames": 0, "scenes": ["grid"]}
    with pytest.raises(ConfigError, match=r"here: the weights' features.std has the shape") as raised:
        load_trained(saved, "here")
    assert "\n" not in str(raised.value)
    with pytest.raises(NavigatorError, match=r"the weights' features.std has the shape"):
        rebuild(saved, parts.config, None, "here")


def test_weights_that_do_not_fit_are_refused_in_one_line(tmp_path):
    room = room_file(tmp_path)
    parts = make_parts(f"scene={room}", "encoder.width=8", "heads.width=8")
    saved = {"network": plain_weights(parts.policy), "scenes": ["grid"]}
    saved["config"] = config_text(train_config(f"scene={room}", "encoder.width=16", "heads.width=16"))
    saved |= {"extractor": parts.world.scenes[0].extractor, "frames": 0}
    with pytest.raises(ConfigError, match="here: the weights do not fit the network of its configuration") as raised:
        load_trained(saved, "here")
    assert "\n" not in str(raised.value)

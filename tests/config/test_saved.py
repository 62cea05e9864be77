import pytest
import torch
from commands import room_file, train_config
from omegaconf import OmegaConf
from parts import make_parts
from schema1 import CONFIG, old_config, old_weights

from dirl.agent.images import NavigatorError
from dirl.agent.loading import rebuild
from dirl.config.saved import MAX_CHARACTERS, config_text, read_config
from dirl.config.schemas import ConfigError
from dirl.evaluation.protocol import metrics
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


def test_options_and_rules_saved_by_their_old_names_are_read():
    config = train_config("scene=bathroom_02", "imitation.sampled=true", "imitation.goals=fraction:0.75", "goals=all")
    text = config_text(config)
    old = text.replace("  sampled: true", "  drawn: true").replace("fraction:0.75", "share:0.75")
    assert old.count("drawn: true") == old.count("share:0.75") == 1
    assert read_config(old, "here") == read_config(text, "here")
    by_scene = old.replace("\ngoals: all\n", "\ngoals:\n  bathroom_02: share:0.5\n  kitchen_02: [3]\n")
    assert read_config(by_scene, "here").goals == {"bathroom_02": "fraction:0.5", "kitchen_02": [3]}


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


def test_a_configuration_of_schema_1_is_upgraded():
    config = read_config(CONFIG, "here")
    today = train_config("scene=bathroom_02")
    today.trust = []
    # What only a training needs is not upgraded in its details.
    assert {"imitation", "a2c"} >= set(config.losses)
    for name in vars(today):
        if name not in ("losses", "optimiser", "imitation"):
            assert getattr(config, name) == getattr(today, name), name
    assert (config.imitation.fraction, config.imitation.bc_coef.start) == (0.05, 0.3)
    assert config.reinforcement.entropy_coef.end == 0.01


@pytest.mark.parametrize(
    ("name", "value"),
    [("imitation", 5), ("network", []), ("reinforcement", None), ("policy", {}), ("objective", {"name": []})],
)
def test_a_configuration_of_schema_1_with_values_of_other_types_is_refused_in_one_line(name, value):
    values = OmegaConf.to_container(OmegaConf.create(CONFIG))
    told = refusal(OmegaConf.to_yaml(OmegaConf.create({**values, name: value})), "here")
    assert told.startswith("here: holds no configuration of this version")


@pytest.mark.parametrize(
    ("changes", "options"),
    [
        ({}, []),
        ({"heads": "shared"}, ["heads=shared"]),
        (
            {"observation": "sequential", "standardise": "false"},
            ["observation=sequential", "network.standardise=false"],
        ),
    ],
    ids=["dirl", "shared heads", "sequential"],
)
def test_weights_of_schema_1_evaluate_to_the_same_numbers(tmp_path, changes, options):
    room = room_file(tmp_path)
    sizes = ["encoder.width=16", "heads.width=16", "evaluation.max_steps=30", "seed=2"]
    parts = make_parts(f"scene={room}", *sizes, *options)
    expected = parts.protocol.run(parts.policy)
    weights = old_weights(plain_weights(parts.policy))
    assert "encoder.table.mean" in weights
    assert not any(name.startswith(("heads.", "features.")) for name in weights)
    text = old_config(room, width=16, seed=2, **changes)
    facts = {"scenes": ["grid"], "extractor": parts.world.scenes[0].extractor, "frames": 0}
    trained = load_trained({"network": weights, "config": text, **facts}, "here", {"evaluation.max_steps": 30})
    found = trained.protocol.run(trained.policy)
    for name, value in vars(expected).items():
        assert torch.equal(vars(found)[name], value), name
    assert metrics(found) == metrics(expected)
    torch.testing.assert_close(plain_weights(trained.policy), plain_weights(parts.policy))


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
    saved = {"network": plain_weights(parts.policy), "config": old_config(room, width=16), "scenes": ["grid"]}
    saved |= {"extractor": parts.world.scenes[0].extractor, "frames": 0}
    with pytest.raises(ConfigError, match="here: the weights do not fit the network of its configuration") as raised:
        load_trained(saved, "here")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("rooms", {"_target_": "dirl.scenes.catalogue.Rooms"}),
        ("thor", {"_target_": "dirl.scenes.catalogue.Thor", "root": "/x"}),
    ],
)
def test_a_source_saved_by_name_is_the_class(name, options):
    values = OmegaConf.to_container(OmegaConf.create(config_text(train_config())))
    text = OmegaConf.to_yaml(OmegaConf.create({**values, "source": {"name": name, "root": "/x"}}))
    assert read_config(text, "here").source == options

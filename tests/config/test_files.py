"""Configurations in files: read back as they were, and nothing in them is run or resolved; choices of a group."""

from functools import partial

import pytest
from commands import train_config
from refusals import refused

from dirl.config.files import MAX_CHARACTERS, config_text, group_options, read_config

refusal = partial(refused, ".", read_config)


def test_a_saved_configuration_is_read_back_without_trust_and_can_be_changed():
    config = train_config("scene=bathroom_02", "imitation.rule=interval", "trust=[os]")
    text = config_text(config)
    read = read_config(text, "here")
    assert (read.trust, config.trust) == ([], ["os"])
    read.trust = config.trust
    assert read == config
    changed = read_config(text, "here", {"stop.threshold": 0.8, "goals": [51]}, trust=["mine"])
    assert (changed.stop.threshold, changed.goals, changed.trust) == (0.8, [51], ["mine"])


@pytest.mark.parametrize(
    "text", ["scene: [", "colour: red", "seed: -1", "", "- 1", "losses: [a2c]", "seed: !!binary x"]
)
def test_what_is_no_configuration_names_where_it_stood(text):
    told = refusal(text, "here/config.yaml")
    assert told.startswith("here/config.yaml: holds no configuration of this version")


def test_what_could_read_the_environment_or_run_or_grow_is_refused():
    text = config_text(train_config("scene=bathroom_02"))
    assert "${...}" in refusal(text.replace("project: dirl", "project: '${oc.env:HOME}'"), "here")
    assert "YAML aliases" in refusal("a: &a [x]\nb: *a\n" + text, "here")
    assert f"at most {MAX_CHARACTERS} are read" in refusal(text + "#" * MAX_CHARACTERS, "here")
    refusal("scene: !!python/object/apply:os.system ['true']", "here")
    refusal("scene: " + "[" * 5000, "here")
    assert "trust=[os]" in refusal(text.replace("dirl.models.SiameseEncoder", "os.system"), "here")


def test_a_choice_is_a_file_of_the_group_or_of_ones_own(tmp_path):
    own = tmp_path / "mine.yaml"
    own.write_text("_target_: mine.Recogniser\nwidth: 3\n")
    assert group_options("recogniser", None) is None
    assert group_options("recogniser", "ncc") == {"_target_": "dirl.perception.recognition.NCC"}
    assert group_options("recogniser", str(own)) == {"_target_": "mine.Recogniser", "width": 3}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "there is no such file"),
        ("junk", "cannot be read as options: it is no mapping of options"),
        ("a: [", "cannot be read as options: while parsing a flow node"),
        ("width: 3", "has no _target_, which names the class"),
    ],
)
def test_a_file_that_is_none_is_one_line(tmp_path, text, reason):
    own = tmp_path / "mine.yaml"
    if text is not None:
        own.write_text(text)
    refused(f"^recogniser={own}: {reason}", group_options, "recogniser", str(own))

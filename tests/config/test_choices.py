"""Choices of a group of conf/, and files of one's own."""

import pytest

from dirl.config.choices import group_options
from dirl.config.schemas import ConfigError


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
    with pytest.raises(ConfigError) as error:
        group_options("recogniser", str(own))
    assert str(error.value).startswith(f"recogniser={own}: {reason}")
    assert "\n" not in str(error.value)

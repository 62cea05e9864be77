"""What scenes may be called."""

import pytest

from dirl.scenes import SceneError
from dirl.scenes.scene import MAX_NAME, check_name

GOOD = ["bathroom_02", "2nd floor", "Küche (neu)", "台所", "room.v2", "a+b, c-d", "x" * MAX_NAME, "0"]
BAD = ["", " ", "..", "../x", "a\\b", "$x$", "-x", "x.", "a\nb", "a:b", "x" * (MAX_NAME + 1), "é" * 51, "\udcff"]
BAD += ["keys", "items", "forward", "training", "a{b}", "a=b", "'a'", "a%b", "~a"]


def test_bad_names_are_refused_in_one_line():
    for name in GOOD:
        check_name(name, "here")
    for name in BAD:
        with pytest.raises(SceneError, match=r"^here: a scene cannot be called ") as caught:
            check_name(name, "here")
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 250

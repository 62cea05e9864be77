"""What is read off the source of a class is what the class itself says."""

import importlib
import sys
from typing import Any

import pytest
from commands import train_config

from dirl.config.bounds import Bounds
from dirl.config.components import PUBLIC, TARGET, check_sources, components
from dirl.config.schemas import ConfigError
from dirl.config.signatures import class_parameters, read_parameters

OURS = {
    options[TARGET]
    for choice in (["memory=gru"], ["objective=ppo"], ["observation=sequential", "preset=paper"])
    for options in components(train_config(*choice)).values()
}


@pytest.mark.parametrize("target", sorted(PUBLIC | OURS))
def test_the_source_of_every_known_class_says_what_the_class_says(target):
    module, _, name = target.rpartition(".")
    imported, read = class_parameters(getattr(importlib.import_module(module), name)), read_parameters(target)
    assert {name: needed for name, (_, needed) in read.items()} == {name: n for name, (_, n) in imported.items()}
    for name, (kind, _) in read.items():
        if kind is not Any and "Tensor" not in str(kind):
            assert kind == imported[name][0], name


def test_a_users_own_class_is_read_and_not_run(tmp_path, monkeypatch):
    (tmp_path / "house").mkdir()
    (tmp_path / "house" / "__init__.py").write_text("from .rooms import Deeper as Door\nraise RuntimeError")
    (tmp_path / "house" / "rooms.py").write_text(
        "class Mine:\n"
        "    def __init__(self, num_features: int, /, depth: Annotated[int, Bounds(1)], *, rate: Other = 2): ...\n"
        "class Deeper(Mine):\n"
        "    def __init__(self, layers: int | None = open('x', 'w'), **kwargs): ...\n"
        "class Foreign(torch.nn.Module):\n    pass\n"
        "class Round(Round):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    read = read_parameters("house.Door")
    assert read["layers"] == (int | None, False)
    assert read["depth"][0].__metadata__ == (Bounds(1),)
    assert read["rate"] == (Any, False)
    assert list(read) == ["depth", "rate", "layers"]
    unreadable = [f"house.rooms.{name}" for name in ("Foreign", "Round", "Nobody")]
    for unknown in (*unreadable, "nobody.Knows", "Mine", "3", "house.mine-2"):
        assert read_parameters(unknown) is None
    assert "house" not in sys.modules


def test_a_configuration_is_checked_against_the_sources():
    check_sources(train_config())
    config = train_config()
    config.encoder["widht"] = 3
    with pytest.raises(ConfigError, match=r"no option 'encoder\.widht'; did you mean encoder\.width"):
        check_sources(config)

"""Imported by the server whose forks are recipes, before the first of them."""

from forks import compose_once, reading_in_process, warm_up

from dirl.cli.parsing import compose_training
from dirl.config.files import typed

warm_up("train", "evaluate", "report", "scenes", "benchmark")
reading_in_process().start()
compose_once().start()
# The parser of options learns its grammar, and pydantic is imported.
typed(compose_training(["seed=3", "scene=a/room.h5", "imitation={fraction:0.5,max_steps:6}", "losses=[imitation]"]))

"""Imported by the server whose forks are recipes, before the first of them."""

from forks import compose_once, reading_in_process, warm_up

from dirl.cli.parsing import compose_training

warm_up("train", "evaluate", "report", "scenes", "benchmark")
reading_in_process().start()
compose_once().start()
compose_training(())  # the parser of options learns its grammar

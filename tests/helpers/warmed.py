"""Imported by the server whose forks are recipes, before the first of them."""

from forks import reading_in_process, warm_up

warm_up("train", "evaluate", "report", "scenes", "benchmark")
reading_in_process().start()

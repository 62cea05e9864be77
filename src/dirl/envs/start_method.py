"""Imports TorchRL without its side effect: that it makes ``spawn`` the start method of all later processes.

``gymnasium.make`` imports this package in another program, whose own processes may rely on ``fork``. Imported
by `dirl.envs` before anything that imports TorchRL.
"""

import multiprocessing

_before = multiprocessing.get_start_method(allow_none=True)

import torchrl  # noqa: E402, F401

multiprocessing.set_start_method(_before, force=True)

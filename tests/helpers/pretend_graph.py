"""A CUDA graph for tests on a CPU: it records operations when it captures, and a replay computes them once more.

As on a GPU nothing has happened when a capture ends, and reading a value within it, or a shape that depends on one, is
an error.
"""

from contextlib import contextmanager, nullcontext

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

ATEN = torch.ops.aten
WAITS = (ATEN._local_scalar_dense.default, ATEN.nonzero.default, ATEN._unique2.default, ATEN.equal.default)
"""Operations for which the host waits."""


def tensors(*trees):
    return [leaf for leaf in tree_leaves(trees) if isinstance(leaf, torch.Tensor)]


class PretendGraph(TorchDispatchMode):
    """What `torch.cuda.CUDAGraph` is; also the mode in which operations are recorded."""

    def __init__(self):
        super().__init__()
        self.generators, self.calls, self.before, self.made = [], [], {}, set()

    def register_generator_state(self, generator):
        self.generators.append(generator)

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        masks = function is ATEN.index.Tensor and any(index.dtype == torch.bool for index in tensors(args[1]))
        if function in WAITS or masks:
            raise RuntimeError(f"{function}: operation not permitted when stream is capturing")
        generator = kwargs.get("generator")
        if (
            "generator" in kwargs
            and generator is not None
            and all(generator._cdata != own._cdata for own in self.generators)
        ):
            raise RuntimeError("a generator that is not registered with the graph")
        if function._schema.is_mutable:
            for one in tensors(args, kwargs):
                place = one.untyped_storage().data_ptr()
                if place not in self.before and place not in self.made:
                    self.before[place] = (one, one.untyped_storage().clone())
        result = function(*args, **kwargs)
        given = {one.untyped_storage().data_ptr() for one in tensors(args, kwargs)}
        self.made |= {one.untyped_storage().data_ptr() for one in tensors(result)} - given
        self.calls.append((function, args, kwargs, result))
        return result

    def replay(self):
        with torch.no_grad():
            for function, args, kwargs, result in self.calls:
                again = function(*args, **kwargs)
                for old, new in zip(tensors(result), tensors(again), strict=True):
                    if old is not new and old.data_ptr() != new.data_ptr():
                        old.detach().copy_(new)


@contextmanager
def capture(graph, **_):
    states = [generator.get_state() for generator in graph.generators]
    with graph:
        yield
    for one, storage in graph.before.values():
        one.untyped_storage().copy_(storage)
    for generator, state in zip(graph.generators, states, strict=True):
        generator.set_state(state)


class Stream:
    def wait_stream(self, _):
        pass


def pretend(monkeypatch):
    """From now on updates are captured on the CPU; returns the graphs that are made."""
    made = []

    def graph():
        made.append(PretendGraph())
        return made[-1]

    for module in ("training.stacked", "training.loops", "models.policy"):
        monkeypatch.setattr(f"dirl.{module}.reading_waits", lambda tensor: True)
    pretended = {"CUDAGraph": graph, "graph": capture, "Stream": Stream, "current_stream": Stream}
    for name, value in {**pretended, "stream": lambda _: nullcontext()}.items():
        monkeypatch.setattr(torch.cuda, name, value)
    return made

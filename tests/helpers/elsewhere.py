"""A device for tests that computes as the CPU does, and refuses its tensors beside those of the CPU, as a GPU does."""

from contextlib import contextmanager

import torch
import torch._dynamo  # torch imports it at the first factory call, where `Generator` would stand in its annotations
from torch.utils import backend_registration
from torch.utils._python_dispatch import TorchDispatchMode, return_and_correct_aliasing
from torch.utils._pytree import tree_leaves, tree_map

ATEN = torch.ops.aten
MOVES = (ATEN._to_copy.default, ATEN.copy_.default)
INDEXED = (ATEN.index.Tensor, ATEN.index_put_.default, ATEN.index_put.default, ATEN._index_put_impl_.default)
"""Take indices that are on the CPU, as CUDA's do."""


class Module(backend_registration._DummyBackendModule):
    """What torch and TensorDict ask of the module of a device."""

    here = False
    """Only within `device_elsewhere`, or all tests of the process would have an accelerator."""

    def is_available(self):
        return self.here

    def get_rng_state(self, *_):
        return torch.get_rng_state()


backend_registration._setup_privateuseone_for_python_backend("elsewhere", Module())
DEVICE = torch.device("elsewhere:0")


def is_elsewhere(device):
    return device is not None and torch.device(device).type == DEVICE.type


class Elsewhere(torch.Tensor):
    """A tensor of the device, which holds one of the CPU."""

    @staticmethod
    def __new__(cls, held):
        return torch.Tensor._make_wrapper_subclass(
            cls, held.shape, held.stride(), held.storage_offset(), dtype=held.dtype, device=DEVICE
        )

    def __init__(self, held):
        self.held = held

    @classmethod
    def __torch_dispatch__(cls, function, types, args=(), kwargs=None):
        return computed(function, args, kwargs or {})

    def __getitem__(self, index):
        return super().__getitem__(without_lists(index))

    def __setitem__(self, index, value):
        super().__setitem__(without_lists(index), value)

    def tolist(self):
        return self.held.detach().tolist()

    def numpy(self):
        raise TypeError("can't convert a tensor of another device to numpy; use Tensor.cpu() first")


def without_lists(index):
    """An index with tensors for lists, of which torch itself would make tensors of the device in C++."""
    if isinstance(index, tuple):
        return tuple(map(without_lists, index))
    return torch.tensor(index, dtype=torch.int64 if not index else None) if isinstance(index, list) else index


def computed(function, args, kwargs):
    """What an operation gives, on the device of its tensors, or the one that it names."""
    tensors = [one for one in tree_leaves((args, kwargs)) if isinstance(one, torch.Tensor)]
    own = [one for one in tensors if isinstance(one, Elsewhere)]
    others = [one for one in tensors if not isinstance(one, Elsewhere) and one.ndim]
    as_index = function in INDEXED and args[0] in own and not any(one is args[0] for one in others)
    if own and others and function not in MOVES and not as_index:
        raise RuntimeError(f"Expected all tensors to be on the same device, but {function} got some of the CPU")
    target = kwargs.get("device")
    stays = isinstance(args[0], Elsewhere) if function is ATEN.copy_.default else bool(own)
    stays = is_elsewhere(target) if target is not None else stays
    given = {**kwargs, **({} if target is None else {"device": torch.device("cpu")})}
    held = tree_map(lambda one: one.held if isinstance(one, Elsewhere) else one, (args, given))
    known = {id(one.held): one for one in own}
    result = function(*held[0], **held[1])
    if not stays:
        return result
    wrapped = tree_map(lambda one: known.get(id(one), Elsewhere(one)) if isinstance(one, torch.Tensor) else one, result)
    return return_and_correct_aliasing(function, args, kwargs, wrapped)


class Factories(TorchDispatchMode):
    """Makes tensors on the device where a function names it."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        if is_elsewhere(kwargs.get("device")) or any(isinstance(one, Elsewhere) for one in tree_leaves((args, kwargs))):
            return computed(function, args, kwargs)
        return function(*args, **kwargs)


CpuGenerator = torch.Generator


def generator(device="cpu"):
    """The generators of the device are those of the CPU, so that both draw the same numbers."""
    return CpuGenerator("cpu" if is_elsewhere(device) else device)


@contextmanager
def device_elsewhere(monkeypatch):
    """Within this context torch has the device, `DEVICE`."""
    monkeypatch.setattr(Module, "here", True)
    monkeypatch.setattr(torch, "Generator", generator)
    for name in ("tensor", "as_tensor"):
        make = getattr(torch, name)

        def made(*args, make=make, device=None, **options):
            found = make(*args, **options, **({} if is_elsewhere(device) else {"device": device}))
            return found.to(device) if is_elsewhere(device) else found

        monkeypatch.setattr(torch, name, made)
    with Factories():
        yield

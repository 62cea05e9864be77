"""The update of a training as one CUDA graph: hundreds of kernels are launched by one call."""

import sys
from collections.abc import Callable, Collection
from typing import Any, Generic, TypeVar

import torch

Result = TypeVar("Result")

WARM_UP = 3
"""Updates before the capture: libraries choose their kernels, and optimisers make their state. They count."""


class Captured(Generic[Result]):
    """A function of no arguments that reads and writes tensors in place; on a GPU its kernels are replayed.

    What cannot be captured is called as it is, and the reason is told in one line. (tensordict's ``CudaGraphModule``
    synchronises before every replay, copies what it returns, and cannot register a generator.)

    Args:
        function: the same operations on the same memory at each call. Its result is overwritten by the next one.
        generators: that it draws from, besides torch's own.
        device: where it computes; it is only captured on a GPU.
    """

    def __init__(
        self, function: Callable[[], Result], generators: Collection[torch.Generator], device: torch.device
    ) -> None:
        self.function, self.generators = function, generators
        self.calls, self.graph, self.result = 0, None, None
        self.captures = is_gpu(device)
        self.stream: Any = torch.cuda.Stream() if self.captures else None

    graph: torch.cuda.CUDAGraph | None
    result: Result | None

    def __call__(self) -> Result:
        """Call the function; from the fourth time on by its graph."""
        self.calls += 1
        if self.graph is None and self.captures and self.calls > WARM_UP:
            self._capture()
        if self.graph is not None:
            self.graph.replay()
            return self.result  # type: ignore[return-value]
        if not self.captures:
            return self.function()
        # Not on the default stream, with which a capture must share nothing.
        self.stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self.stream):
            result = self.function()
        torch.cuda.current_stream().wait_stream(self.stream)
        return result

    def _capture(self) -> None:
        graph = torch.cuda.CUDAGraph()
        for generator in self.generators:
            graph.register_generator_state(generator)
        try:
            with torch.cuda.graph(graph, stream=self.stream):
                self.result = self.function()
            self.graph = graph
        except Exception as error:
            self.captures = False
            reason = " ".join(str(error).split())[:200]
            print(f"no CUDA graph, each kernel is launched by itself: {reason}", file=sys.stderr, flush=True)


def is_gpu(device: torch.device) -> bool:
    """True if there are graphs on the device."""
    return device.type == "cuda"

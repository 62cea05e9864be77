"""Bounds of numbers, in the annotations of options and of constructors' parameters: ``Annotated[int, Bounds(1)]``."""

from collections.abc import Iterator
from dataclasses import dataclass

from annotated_types import BaseMetadata, Ge, GroupedMetadata, Le


@dataclass(frozen=True)
class Bounds(GroupedMetadata):
    """The smallest and the largest value that a number may have, both included; None = no bound."""

    least: float | None = None
    most: float | None = None

    def __iter__(self) -> Iterator[BaseMetadata]:
        """Yield them as pydantic reads them."""
        yield from [Ge(self.least)] if self.least is not None else []
        yield from [Le(self.most)] if self.most is not None else []

"""Bounds of numbers, in the annotations of options and of constructors' parameters: ``Annotated[int, Bounds(1)]``."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Bounds:
    """The smallest and the largest value that a number may have, both included; None = no bound."""

    least: float | None = None
    most: float | None = None

    def __contains__(self, value: float) -> bool:
        """Whether a number lies within them."""
        return (self.least is None or value >= self.least) and (self.most is None or value <= self.most)

    def __str__(self) -> str:
        """In words, for errors."""
        if self.least is not None and self.most is not None:
            return f"between {self.least} and {self.most}"
        return f"at least {self.least}" if self.most is None else f"at most {self.most}"

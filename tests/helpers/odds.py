"""A recogniser whose scores are log odds, of a few lines."""

from dirl.perception.recognition import NCC


class Odds(NCC):
    """Correlation as log odds: sure of what was made with little noise."""

    calibrated = True

    def __init__(self, scale=60.0):
        super().__init__()
        self.scale = scale

    def scores(self, seen, references):
        return self.scale * (super().scores(seen, references) - 0.8)

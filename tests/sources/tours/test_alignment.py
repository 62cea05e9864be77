"""The headings of a tour's panoramas from the yaws of links both ways."""

import numpy as np
from tours import grid_truth, heading_errors, tour_of, turned

from dirl.sources.tours.alignment import align

FAR_APART = {(6, 11), (8, 9), (17, 22), (19, 24)}
"""Of the 49 pairs of links in a grid of 6 by 5; whatever part is cut off, most of the links to it are right."""


def test_panoramas_turned_at_random_are_aligned_again():
    truth = turned(grid_truth(6, 5), 1.0, 1)
    found = align(tour_of(truth))
    assert heading_errors(found.headings, truth.middles).max() < 1e-6
    assert found.loops.max() < 1e-6
    assert len(found.loops) == 49 - 29  # links less a spanning tree
    assert (found.part == 0).all()
    assert (found.rejected, found.one_way) == ([], [])


def test_links_that_are_all_wrong_are_found_and_left_out():
    truth = turned(grid_truth(6, 5), 1.0)
    rng = np.random.default_rng(0)
    pairs = [index for index, link in enumerate(truth.links) if link[:2] in FAR_APART]
    off = np.zeros(len(truth.links))
    off[pairs] = rng.uniform(40, 180, len(pairs)) * rng.choice([-1, 1], len(pairs))
    found = align(tour_of(truth, off))
    assert heading_errors(found.headings, truth.middles).max() < 1e-6
    assert {pair[:2] for pair in found.rejected} == {truth.links[index][:2] for index in pairs}
    assert min(pair[2] for pair in found.rejected) > 39.9
    assert found.loops.max() > 39.9

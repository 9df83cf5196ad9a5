"""The coarse search: what it rules out, what it must not, and what that is worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.processing.dpv import DEFAULT_DPV, auto_range, light_field_evidence, plane_grid
from lfrig.processing.kernels.plane_cost import PlaneGrid
from lfrig.processing.matching_views import matching_views
from lfrig.processing.model import LightField
from lfrig.processing.plane_search import DEFAULT_SEARCH, Search, coarse_costs, coarse_match
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally
from tests.processing import scenes


@pytest.fixture(scope="module")
def light_field() -> LightField:
    return scenes.light_field("a", 0.0)


def true_disparity() -> np.ndarray:
    depth = scenes.look(0.0, 0.0)[1]
    return scenes.BASELINE_M * scenes.FOCAL * (1 / depth - 1 / scenes.FOCUS_M)


def search(light_field: LightField, grid: PlaneGrid) -> Search:
    views = matching_views(light_field, 0.0)
    costs = coarse_costs(views.half, grid, 23.0, DEFAULT_SEARCH, chosen=views.half.cross(), threads=1, monitor=None)
    return coarse_match(costs, light_field.centre_view, DEFAULT_DPV.matching(grid.step), DEFAULT_SEARCH, threads=1)


def test_spans_hold_the_truth_and_leave_most_planes_out(light_field: LightField) -> None:
    grid = plane_grid((-1.0, 1.0), DEFAULT_DPV)
    truth = true_disparity()
    span = search(light_field, grid).span(grid, truth.shape, DEFAULT_SEARCH)
    assert span is not None and (span[..., 0] < span[..., 1]).all()
    assert span.min() >= 0 and span.max() <= grid.count
    first, past = (span[..., i].repeat(8, 0).repeat(8, 1)[: truth.shape[0], : truth.shape[1]] for i in (0, 1))
    plane = (truth - grid.first) / grid.step
    inside = (plane >= first) & (plane <= past - 1)
    assert inside[8:-8, 8:-8].mean() > 0.999
    assert (span[..., 1] - span[..., 0]).mean() < 0.6 * grid.count


def test_no_spans_where_nothing_would_be_saved() -> None:
    grid = PlaneGrid(-1.0, 0.02, 101)
    anything = Search(*(np.full((5, 7), d, np.float32) for d in (0.0, -0.9, 0.9)))
    assert anything.span(grid, (11, 14), DEFAULT_SEARCH) is None
    one = Search(*(np.full((5, 7), d, np.float32) for d in (0.0, 0.0, 0.0))).span(grid, (11, 14), DEFAULT_SEARCH)
    assert one is not None and one.shape == (2, 2, 2)
    middle, slack = 50, DEFAULT_SEARCH.slack_px / 0.02
    assert (one[..., 0] <= middle - slack + 1).all() and (one[..., 1] > middle + slack - 1).all()
    assert (one[..., 1] - one[..., 0] <= 2 * slack + 3).all()


@pytest.mark.parametrize("noise", [0.0, 6.0])
def test_skipping_costs_no_accuracy(light_field: LightField, noise: float) -> None:
    rng = np.random.default_rng(0)
    views = light_field.views + rng.normal(0, noise, light_field.views.shape)
    shot = replace(light_field, views=np.clip(np.rint(views), 0, 255).astype(np.uint8))
    tally = Tally()
    settings = replace(DEFAULT_DPV, quiet_grey=4.5)  # its fine texture looks like noise at half size
    errors = [
        np.abs(light_field_evidence(shot, (-1.0, 1.0), settings, skips=skips, tally=tally).disparity - true_disparity())
        for skips in (SKIP_ALL, Skips.nothing())
    ]
    assert np.median(errors[0]) <= 1.1 * np.median(errors[1]) + 0.002
    assert (errors[0] > 0.07).mean() <= (errors[1] > 0.07).mean() + 0.01
    planes, compared = tally.counts["planes"], tally.counts["views"]
    assert planes.done > 0 and planes.skipped > 0 and planes.unit == compared.unit
    assert (compared.skipped > 0) == (noise == 0), "noise asks for all views"


def test_nothing_is_counted_where_nothing_is_skipped(light_field: LightField) -> None:
    tally = Tally()
    light_field_evidence(light_field, (-0.5, 0.5), skips=Skips.nothing(), tally=tally)
    assert not tally.counts
    light_field_evidence(light_field, (-0.5, 0.5), skips=SKIP_ALL.without("views"), tally=tally)
    assert tally.counts["views"].skipped == 0


def test_probability_is_zero_outside_the_spans(light_field: LightField) -> None:
    evidence = light_field_evidence(light_field, (-1.0, 1.0))
    assert (evidence.probability == 0).mean() > 0.3
    assert (np.abs(evidence.probability.sum(2, dtype=np.int64) - 65535) <= evidence.planes).all()


def test_a_range_beyond_the_usual_limit_gets_wider_margins(light_field: LightField) -> None:
    views = matching_views(light_field, 1.0)
    evidence = light_field_evidence(light_field, (-5.0, 1.0), views=views)
    assert evidence.planes_px[0] == -5.0
    assert np.median(np.abs(evidence.disparity - true_disparity())) < 0.05


def test_the_cross_finds_the_range_that_all_views_find(light_field: LightField) -> None:
    cross, every = (auto_range(light_field, skips=skips) for skips in (SKIP_ALL, Skips.nothing()))
    assert np.allclose(cross, every, atol=0.25)

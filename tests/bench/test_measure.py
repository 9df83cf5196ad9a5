from __future__ import annotations

import os
import time

import numpy as np
import pytest

from lfrig.bench.measure import Cost, in_fresh_process, stopwatch, summary
from lfrig.contracts.errors import CheckFailed, GeometryRefused, Interrupted
from lfrig.contracts.progress import Monitor, Muted


def busy(seconds: float) -> int:
    """Use the processor for that long; returns the process that did."""
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return os.getpid()


def hungry(megabytes: int) -> int:
    return int(np.ones(megabytes << 17).sum())


def refusing() -> None:
    raise GeometryRefused("too few anchors", code="too-few-anchors", remedy="shoot more", path="capture 001")


def buggy() -> None:
    raise KeyError("a bug")


def dying() -> None:
    os._exit(7)


def sleeping() -> None:
    time.sleep(60)


def test_a_stopwatch_counts_processor_time_not_waiting() -> None:
    with stopwatch() as waiting:
        time.sleep(0.05)
    with stopwatch() as working:
        busy(0.05)
    assert waiting.cost is not None and working.cost is not None
    assert waiting.cost.wall_s >= 0.05 and waiting.cost.cpu_s < 0.04
    assert working.cost.cpu_s >= 0.05 and working.cost.peak_rss_mb is None


def test_a_fresh_process_has_times_and_memory_of_its_own() -> None:
    own, small = in_fresh_process(busy, 0.1, monitor=Monitor())
    assert own != os.getpid() and small.cpu_s >= 0.1
    _, large = in_fresh_process(hungry, 200, monitor=Monitor())
    assert small.peak_rss_mb is not None and large.peak_rss_mb is not None
    assert large.peak_rss_mb > small.peak_rss_mb + 150


def test_errors_come_through_as_they_are() -> None:
    with pytest.raises(GeometryRefused) as error:
        in_fresh_process(refusing, monitor=Monitor())
    assert (error.value.code, error.value.remedy) == ("too-few-anchors", "shoot more")
    assert error.value.message == "capture 001: too few anchors"
    with pytest.raises(RuntimeError, match="a bug"):
        in_fresh_process(buggy, monitor=Monitor())
    with pytest.raises(CheckFailed, match="exit code 7"):
        in_fresh_process(dying, monitor=Monitor())


def test_a_cancel_ends_the_process() -> None:
    monitor = Monitor()
    monitor.cancel()
    with pytest.raises(Interrupted):
        in_fresh_process(sleeping, monitor=monitor)


def test_a_muted_monitor_keeps_warnings_and_hears_cancels() -> None:
    outer = Monitor()
    muted = Muted(outer)
    muted.warn("code", "words")
    muted.advance()
    assert outer.notices == [] and len(muted.notices) == 1
    outer.cancel()
    with pytest.raises(Interrupted):
        muted.advance(0)


def test_a_summary_has_medians_and_extremes() -> None:
    fields = summary([Cost(1, 4, 100), Cost(3, 6, 300), Cost(2, 5, 200)])
    assert fields == {
        "runs": 3, "wall_s": 2, "wall_s_min": 1, "wall_s_max": 3, "cpu_s": 5, "cpu_s_min": 4, "cpu_s_max": 6,
        "peak_rss_mb": 300,
    }  # fmt: skip
    assert "peak_rss_mb" not in summary([Cost(1, 1)])

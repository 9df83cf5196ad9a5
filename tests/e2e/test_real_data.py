"""Real and published light fields through the command line, where they lie beside the checkout."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfrig.processing.export.pfm import read_pfm

pytestmark = pytest.mark.slow
BORDER_PX = 15


def test_hci_cotton(lfrig, shared_data: Path, tmp_path: Path) -> None:
    """BadPix(0.07) of at most 4 %, without a border of 15 px, on the central 7×7 of 9×9 views."""
    source = shared_data / "hci_cotton"
    outcome = lfrig("depth", source, "--out", tmp_path / "depth")
    assert outcome.code == 0, outcome.err
    error = np.abs(read_pfm(tmp_path / "depth" / "disparity.pfm") - read_pfm(source / "gt_disp_lowres.pfm"))
    assert np.mean(error[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] > 0.07) <= 0.04


def test_lytro_illum(lfrig, shared_data: Path, tmp_path: Path) -> None:
    """No truth, but its disparities are known to lie in 0.05–1.35 px, and most of it is sure."""
    session = tmp_path / "session"
    assert lfrig("ingest", session, shared_data / "lytro_illum_2067").code == 0
    outcome = lfrig("depth", session / "captures" / "000", "--out", tmp_path / "depth", "--json")
    assert outcome.code == 0, outcome.err
    assert outcome.json["mean_confidence"] > 0.8
    disparity = read_pfm(tmp_path / "depth" / "disparity.pfm")
    sure = np.load(tmp_path / "depth" / "confidence.npy") > 0.8
    assert np.mean((disparity[sure] > -0.05) & (disparity[sure] < 1.45)) > 0.98
    assert not (tmp_path / "depth" / "inverse_depth.npy").exists()  # its optics are not known

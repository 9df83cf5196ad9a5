from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lfrig.contracts.errors import BadInput
from lfrig.processing.export.pfm import decode_pfm, encode_pfm, read_pfm, write_pfm

SHAPES = st.tuples(st.integers(1, 7), st.integers(1, 9)) | st.tuples(st.integers(1, 5), st.integers(1, 5), st.just(3))
IMAGES = SHAPES.flatmap(lambda shape: arrays(np.float32, shape, elements=st.floats(width=32)))


@given(image=IMAGES, little=st.booleans())
def test_round_trip_keeps_every_bit(image: np.ndarray, little: bool) -> None:
    back = decode_pfm(encode_pfm(image, little_endian=little))
    assert back.dtype == np.float32 and back.dtype.isnative
    np.testing.assert_array_equal(back, image)


def test_layout_is_bottom_up_little_endian() -> None:
    data = encode_pfm(np.array([[1.0, 2.0], [3.0, 4.0]], np.float32))
    assert data == b"Pf\n2 2\n-1\n" + np.array([3, 4, 1, 2], "<f4").tobytes()


def test_colour_big_endian_as_others_write_it() -> None:
    pixels = np.arange(6, dtype=">f4")
    image = decode_pfm(b"PF 1 2 1.0\n" + pixels.tobytes())
    np.testing.assert_array_equal(image, [[[3, 4, 5]], [[0, 1, 2]]])


@pytest.mark.parametrize(
    "data",
    [b"", b"P6\n2 2\n255\n" + bytes(12), b"Pf\n2 2\n-1\n" + bytes(15), b"Pf\n2 2\n-1\n" + bytes(17), b"Pf\n0 2\n-1\n",
     b"Pf\n2 2\n0\n" + bytes(16)],
    ids=["empty", "ppm", "short", "long", "no width", "no scale"],
)  # fmt: skip
def test_damaged_files_are_named(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "map.pfm"
    path.write_bytes(data)
    with pytest.raises(BadInput, match=r"map\.pfm"):
        read_pfm(path)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"none\.pfm: does not exist"):
        read_pfm(tmp_path / "none.pfm")


@pytest.mark.parametrize("shape", [(3,), (2, 2, 4), (0, 4)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(BadInput, match="PFM"):
        encode_pfm(np.zeros(shape, np.float32))


def test_reads_what_the_benchmark_ships(shared_data: Path, tmp_path: Path) -> None:
    disparity = read_pfm(shared_data / "hci_cotton" / "gt_disp_lowres.pfm")
    assert disparity.shape == (512, 512)
    assert -1.7 < disparity.min() < -1.4 < 1.3 < disparity.max() < 1.6  # parameters.cfg: −1.6 … 1.5
    # The bytes are the benchmark's own, header included.
    write_pfm(tmp_path / "again.pfm", disparity)
    assert (tmp_path / "again.pfm").read_bytes() == (shared_data / "hci_cotton" / "gt_disp_lowres.pfm").read_bytes()

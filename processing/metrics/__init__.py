"""How accuracy is measured: disparity, views and confidence against a truth. Pure functions, arrays in,
numbers out.

- ``pixels``      which pixels are scored: the border, depth edges, textureless areas
- ``disparity``   MSE, PPE, BadPix, Q25, with and without a linear alignment
- ``views``       PSNR, SSIM and the EPI error of light fields
- ``confidence``  is a confidence worth its name: sparsification (AUSE) and reliability
"""

from lfrig.processing.metrics.confidence import Reliability, Sparsification, reliability, sparsification
from lfrig.processing.metrics.disparity import disparity_score, disparity_scores, linear_alignment
from lfrig.processing.metrics.pixels import BORDER_PX, depth_edges, inner_region, textureless
from lfrig.processing.metrics.views import light_field_score, psnr, ssim

__all__ = [
    "BORDER_PX",
    "Reliability",
    "Sparsification",
    "depth_edges",
    "disparity_score",
    "disparity_scores",
    "inner_region",
    "light_field_score",
    "linear_alignment",
    "psnr",
    "reliability",
    "sparsification",
    "ssim",
    "textureless",
]

"""How good a sample is, and whether two are the same one again: measures on pictures and poses. Pure."""

from common.quality.blur import blur
from common.quality.duplicates import (
    ALIKE_BITS,
    ALIKE_DEG,
    ALIKE_SHARE,
    View,
    differing_bits,
    near_views,
    perceptual_hash,
)
from common.quality.sharpness import edge_sharpness, sharpness_of

__all__ = [
    "ALIKE_BITS",
    "ALIKE_DEG",
    "ALIKE_SHARE",
    "View",
    "blur",
    "differing_bits",
    "edge_sharpness",
    "near_views",
    "perceptual_hash",
    "sharpness_of",
]

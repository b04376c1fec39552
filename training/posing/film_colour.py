"""Colours of a film's frame as sRGB: by its tags of matrix and range, with wide gamuts and HDR transfer functions converted.

Notation: a signal is R'G'B' as it is coded, in [0, 1]; light is linear R, G, B, and 1 is diffuse white.

HLG: the inverse OETF gives light of the scene (ITU-R BT.2100, table 5); diffuse white is at 75 % of the signal. PQ: the EOTF
gives light of the display (table 4); diffuse white has 203 cd/m² (BT.2408, 2.2). Light up to KNEE stays as it is. Above,
Reinhard's extended curve goes on with the same slope and brings the brightest light to 1: diffuse white becomes 244 of 255.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from training.scenes.deep_pictures import linear_to_srgb

# Values of ITU-T H.273, which FFmpeg has as AVCOL_…: transfer characteristics, primaries, matrix coefficients.
PQ, HLG = 16, 18
BT709, BT601, BT2020, P3 = 1, 5, 9, 12
UNSPECIFIED = (2, 3)  # 3: reserved
# Matrices that swscale does not know, and would take for another.
REFUSED = {8: "YCgCo", 11: "YDzDx", 14: "ICtCp", 15: "IPT (Dolby Vision, profile 5)", 16: "YCgCo-R", 17: "YCgCo-R"}
SD_SIZE = (1279, 576)  # width and height up to which players take an untagged film as BT.601, and above as BT.709
KNEE = 0.8
DIFFUSE_WHITE_HLG = 0.75  # of the signal
DIFFUSE_WHITE_PQ, BRIGHTEST_PQ = 203.0, 1000.0  # cd/m²; what is brighter is clipped
LEVELS = 1 << 16
BAND_PIXELS = 1 << 20  # that are converted at once
# To the primaries of sRGB (BT.709), both with white D65. Rows sum to 1.
SRGB_T_BT2020 = np.array(
    [[1.660491, -0.587641, -0.072850], [-0.124550, 1.132900, -0.008349], [-0.018151, -0.100579, 1.118730]]
)
SRGB_T_P3 = np.array([[1.224940, -0.224940, 0.0], [-0.042057, 1.042057, 0.0], [-0.019638, -0.078636, 1.098274]])


def with_matrix(frame: Any, film: Path) -> Any:
    """A decoded frame of a film, with the matrix that players take where none is said. UserError where it is not supported."""
    if frame.format.is_rgb:
        return frame
    if frame.colorspace in REFUSED:
        raise UserError("the film's colours are coded in a way that is not read", where=film, found=REFUSED[frame.colorspace],
                        expected="BT.601, BT.709 or BT.2020", remedy="export it as H.264")  # fmt: skip
    if frame.colorspace in UNSPECIFIED:
        is_hd = frame.width > SD_SIZE[0] or frame.height > SD_SIZE[1]
        is_uhd = frame.color_trc in (PQ, HLG) or frame.color_primaries == BT2020
        frame.colorspace = BT2020 if is_uhd else BT709 if is_hd else BT601
    return frame


def srgb_of(frame: Any, width: int) -> np.ndarray:
    """A frame with its matrix as uint8 [H, width, 3]."""
    hdr = frame.color_trc if frame.color_trc in (PQ, HLG) else None
    matrix = _gamut(frame.color_primaries, hdr is not None)
    if hdr is None and matrix is None:
        return frame.to_ndarray(format="rgb24", width=width, height=frame.height)
    return _converted(frame.to_ndarray(format="rgb48le", width=width, height=frame.height), hdr, matrix)


def _gamut(primaries: int, hdr: bool) -> np.ndarray | None:
    """What brings light of these primaries to sRGB's; None for sRGB's own and what is close to it."""
    if primaries == BT2020 or (hdr and primaries in UNSPECIFIED):
        return SRGB_T_BT2020.astype(np.float32)
    return SRGB_T_P3.astype(np.float32) if primaries == P3 else None


def _converted(signal: np.ndarray, hdr: int | None, matrix: np.ndarray | None) -> np.ndarray:
    """uint16 [H, W, 3] in the film's transfer function and primaries as uint8 sRGB."""
    light_of, brightest, code_of = _tables(hdr)
    out = np.empty(signal.shape, np.uint8)
    rows = max(BAND_PIXELS // signal.shape[1], 1)
    for first in range(0, len(signal), rows):
        light = light_of[signal[first : first + rows]]
        if matrix is not None:
            light = light @ matrix.T
        steps = np.sqrt(np.clip(light / brightest, 0, 1)) * (LEVELS - 1)
        out[first : first + rows] = code_of[np.rint(steps).astype(np.uint16)]
    return out


@cache
def _tables(hdr: int | None) -> tuple[np.ndarray, float, np.ndarray]:
    """Light float32 of each of LEVELS signals; the brightest that is kept; uint8 sRGB by LEVELS square roots of its shares."""
    signal = np.linspace(0, 1, LEVELS)
    if hdr == HLG:
        light = hlg_to_scene(signal) / float(hlg_to_scene(np.array(DIFFUSE_WHITE_HLG)))
        brightest = float(light[-1])
    elif hdr == PQ:
        light, brightest = pq_to_nits(signal) / DIFFUSE_WHITE_PQ, BRIGHTEST_PQ / DIFFUSE_WHITE_PQ
    else:
        light, brightest = srgb_to_linear(signal), 1.0
    kept = np.linspace(0, 1, LEVELS) ** 2 * brightest
    shown = kept if hdr is None else tone_mapped(kept, brightest)
    return light.astype(np.float32), brightest, np.rint(linear_to_srgb(shown) * 255).astype(np.uint8)


def tone_mapped(light: np.ndarray, brightest: float) -> np.ndarray:
    """Light as a display shows it that has nothing brighter than 1. brightest: what becomes 1."""
    above, most = (np.maximum((value - KNEE) / (1 - KNEE), 0) for value in (light, np.float64(brightest)))
    return np.where(light <= KNEE, light, KNEE + (1 - KNEE) * above * (1 + above / most**2) / (1 + above))


def hlg_to_scene(signal: np.ndarray) -> np.ndarray:
    """The inverse OETF of HLG: light of the scene in [0, 1]."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(signal <= 0.5, signal**2 / 3, (np.exp((signal - c) / a) + b) / 12)


def pq_to_nits(signal: np.ndarray) -> np.ndarray:
    """The EOTF of PQ: light of the display in cd/m²."""
    m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 4096 * 128, 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
    power = signal ** (1 / m2)
    return 10000 * (np.maximum(power - c1, 0) / (c2 - c3 * power)) ** (1 / m1)


def srgb_to_linear(signal: np.ndarray) -> np.ndarray:
    return np.where(signal <= 0.04045, signal / 12.92, ((signal + 0.055) / 1.055) ** 2.4)

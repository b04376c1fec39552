"""Exposure and white balance of each photograph, fitted along with the field and left out of the pack.

    photograph = gain shown,      mean of log gain over the photographs = 0,

for each channel of display colours, where `shown` is the field's colour. Field and pack are compared with photograph / gain.
Gains are fitted every few steps by least squares. A ridge towards 1 keeps gains from drifting slowly from view to view.

Notation: V photographs, K sampled rays of each.
"""

import numpy as np

FITTED_FROM, FIT_EVERY = 100, 25  # steps: before, the field shows nothing to compare with
RAYS, FEWEST, MOST = 16_384, 64, 256  # rays of a fit in all, and of a photograph
RIDGE = 0.05  # towards 1, as a share of what a photograph's rays say
CHANGED = 0.5  # how far gains go towards those that were fitted: the rays of one fit are few
BRIGHTEST = 250  # of 255: a photograph's pixel beyond is clipped
OPAQUE = 0.5  # of the field's opacity: a ray with less shows the background
FEWEST_WITNESSES = 16  # rays that count, of a photograph with a gain of its own
GAINS = (0.4, 2.5)  # no camera goes further on its own
# Root mean square of the log gains below which "auto" leaves photographs as they are. It is 0.03 on captures of one exposure.
LEAST_SPREAD = 0.05


def drawn(first: np.ndarray, count: int, seed: tuple[int, int]) -> np.ndarray:
    """Ids int64 [V, K] of random rays of each photograph. first [V]: the id of its first ray. count: of all rays."""
    low, high = first.astype(np.int64), np.append(first[1:], count).astype(np.int64)
    rays = int(np.clip(RAYS // len(low), FEWEST, MOST))
    return np.random.default_rng((*seed, FITTED_FROM)).integers(low[:, None], high[:, None], (len(low), rays))


def fitted(gains: np.ndarray, look: np.ndarray, opacity: np.ndarray, pixels: np.ndarray, *, auto: bool) -> np.ndarray:
    """Gains float32 [V, 3] after a fit, from those before; all are 1 where `auto` finds that exposures do not differ.

    look [V, K, 3]: the field's colour without a background, premultiplied by its opacity [V, K]. pixels: uint8 [V, K, 3 or 4].
    """
    counts = (opacity > OPAQUE) & (pixels[..., :3].max(-1) <= BRIGHTEST)
    if pixels.shape[-1] == 4:
        counts &= pixels[..., 3] == 255
    look = np.where(counts[..., None], look, 0.0).astype(np.float64)
    photograph = pixels[..., :3] / 255.0 * opacity[..., None]
    with np.errstate(invalid="ignore", divide="ignore"):
        found = (photograph * look).sum(1) / (look * look).sum(1)
    known = (counts.sum(1) >= FEWEST_WITNESSES)[:, None] & np.isfinite(found)
    logs = (1.0 - RIDGE) * np.log(np.clip(np.where(known, found, 1.0), *GAINS))
    logs = np.where(known, logs - logs.mean(0, where=known) if known.any(0).all() else logs, 0.0)
    if auto and np.sqrt(np.square(logs).mean()) < LEAST_SPREAD:
        return np.ones_like(gains)
    before = np.log(gains.astype(np.float64))
    share = CHANGED if before.any() else 1.0
    logs = before + share * (logs - before)
    return np.clip(np.exp(logs - logs.mean(0)), *GAINS).astype(np.float32)

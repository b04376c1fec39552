"""Where to begin in a scene that surrounds its cameras, as contracted packs do: rooms are seen from within, not from behind their
walls."""

from __future__ import annotations

import numpy as np

from scenepack.pack import Pack
from viewer.app.photographs import shots_of
from viewer.rendering.camera import ViewCamera, content_box

CLOSE = 0.1  # of the content's diagonal: cameras that far outside of its box still count as within


def view_from_within(pack: Pack) -> ViewCamera | None:
    """The training photograph in the midst of the others; None where most were taken from outside, or none is known."""
    views = [shot.view for shot in shots_of(pack) if shot.split == "train"]
    if not views:
        return None
    low, high = content_box(pack)
    margin = CLOSE * np.linalg.norm(high - low)
    eyes = np.array([view.position for view in views])
    within = np.all((eyes > low - margin) & (eyes < high + margin), axis=1).mean() >= 0.5
    if pack.contraction is None and not within:
        return None
    backs = np.array([view.grid_T_camera[:3, 2] for view in views])
    spread = max(float(np.linalg.norm(eyes - eyes.mean(0), axis=1).mean()), 1e-9)
    away = np.linalg.norm(eyes - np.median(eyes, axis=0), axis=1) / spread
    turned = np.linalg.norm(backs - np.median(backs, axis=0), axis=1)
    return views[int(np.argmin(away + turned))]

"""The camera paths of the paper's measurement (SNeRG paper, appendix B): 150 frames around the scene, or in the camera plane.

The paper takes the intrinsics of its photographs, and names fields of view and sizes. It does not name the distance: here it is
that of the photographs, too. Cameras of NeRF-synthetic stand 4.0311 from the origin and look at it; those of spherified 360°
scenes on a unit sphere; those of unbounded scenes (no scenes of the paper) near it. Packs that do not lie so (other scenes,
parts of scenes) are orbited as close as shows all of their content. Nor does the paper name the height: orbits are
ORBIT_ELEVATION above the horizon.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from console import UserError
from scenepack.pack import Pack
from viewer.rendering.camera import ORBIT_ELEVATION, ViewCamera, content_box, forward_facing_path

FITTED = "content"  # the word of --distance for the orbit that shows all of the content


@dataclass(frozen=True)
class Protocol:
    fov: float  # vertical, degrees
    size: tuple[int, int]  # width, height in pixels
    distance: float | None  # of the paper's cameras from the origin, units of the training frame; None: no orbit


PROTOCOLS: dict[str, Protocol] = {
    "synthetic": Protocol(39.0, (800, 800), 4.0311),
    "forward-facing": Protocol(53.0, (1006, 756), None),
    "real360": Protocol(53.0, (990, 773), 1.0),
}


@dataclass(frozen=True)
class Flight:
    """The cameras of a measurement.

    facts: what its JSON says of them: protocol, fov, width, height; distance from what is looked at (grid units), and
    distance_from, "paper", "content" or "given"; both are None where they do not orbit.
    """

    cameras: Sequence[ViewCamera]
    facts: Mapping[str, Any]


def protocol_for(pack: Pack, asked: str = "auto") -> str:
    """The protocol that suits the pack. UserError where another is asked for."""
    if asked == "auto":
        made = pack.metadata.get("provenance")
        spherified = isinstance(made, dict) and made.get("spherify") is True
        around = spherified or pack.contraction is not None
        return "forward-facing" if pack.ndc else "real360" if around else "synthetic"
    if (asked == "forward-facing") != pack.ndc:
        kind = "forward-facing (NDC)" if pack.ndc else "not forward-facing"
        raise UserError(f"does not suit this pack, which is {kind}", where=f"--protocol {asked}")
    return asked


def flight(
    pack: Pack, protocol: str, frames: int, *, fov: float | None = None, size: tuple[int, int] | None = None,
    distance: str = "auto",
) -> Flight:  # fmt: skip
    """The cameras of a protocol for a pack.

    distance: "paper"; "content"; a number, in grid units, from the origin of the training frame; or "auto": the paper's where the
    pack lies within its cameras' orbit, as its scenes do, or is unbounded. UserError for anything else.
    """
    chosen = PROTOCOLS[protocol]
    fov, size = fov or chosen.fov, size or chosen.size
    facts = {"protocol": protocol, "fov": fov, "width": size[0], "height": size[1]}
    if pack.ndc:
        cameras = forward_facing_path(pack, frames, fov, size)
        return Flight(cameras, {**facts, "distance": None, "distance_from": None})
    assert chosen.distance is not None, "only forward-facing cameras do not orbit"
    number, named = given_distance(distance), "given"
    origin = np.linalg.inv(pack.worldspace_T_opengl)[:3, 3]  # of the training frame, in the grid frame
    farthest = float(np.linalg.norm(np.abs(content_box(pack) - origin).max(axis=0)))
    # else cameras of the paper's orbit would stand in the content
    as_in_paper = pack.contraction is not None or farthest < chosen.distance
    if number is None and (distance == "paper" or (distance == "auto" and as_in_paper)):
        number, named = chosen.distance, "paper"
    middle = origin if number is not None else np.mean(content_box(pack), axis=0)  # which is looked at
    turns = (360.0 * i / frames for i in range(frames))  # about the grid's y axis
    cameras = [ViewCamera.orbit(pack, turn, ORBIT_ELEVATION, number, fov, size, middle) for turn in turns]
    if number is None:
        number, named = float(np.linalg.norm(cameras[0].position - middle)), FITTED
    return Flight(cameras, {**facts, "distance": number, "distance_from": named})


def given_distance(text: str) -> float | None:
    """The number of --distance; None where it is one of its words. UserError for anything else."""
    if text in ("auto", "paper", FITTED):
        return None
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not (isfinite(number) and 0 < number < 1e6):
        expected = "auto, paper, content or a positive number"
        raise UserError("is not a distance", where="--distance", expected=expected, found=repr(text))
    return number

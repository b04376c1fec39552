"""Pose errors of one scene, given another of the same photographs: `python -m tools.pose_error FOUND GIVEN`.

The two frames are aligned by the similarity (scale, rotation, translation) that brings the positions closest together
(Umeyama, Least-squares estimation of transformation parameters between two point patterns, PAMI 1991).
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from console import UserError, run_command
from training.scenes import Scene, load_scene

FEWEST = 3  # cameras that fix a similarity


@dataclass(frozen=True)
class PoseError:
    names: tuple[str, ...]  # photographs of both scenes
    positions: np.ndarray  # [N] distances of positions, as a share of the cameras' mean distance from their centre
    degrees: np.ndarray  # [N] angles between rotations


def pose_error(found: Scene, given: Scene) -> PoseError:
    """Photographs are paired by the stem of their names. UserError where both scenes share fewer than FEWEST."""
    of_found, of_given = _cameras(found), _cameras(given)
    names = sorted(set(of_found) & set(of_given))
    if len(names) < FEWEST:
        raise UserError("the scenes share too few photographs", where=found.path, expected=f"at least {FEWEST}",
                        found=len(names))  # fmt: skip
    P, Q = (np.stack([cameras[name] for name in names]) for cameras in (of_found, of_given))
    scale, R, t = similarity(P[:, :3, 3], Q[:, :3, 3])
    moved = scale * P[:, :3, 3] @ R.T + t
    spread = np.linalg.norm(Q[:, :3, 3] - Q[:, :3, 3].mean(axis=0), axis=-1).mean()
    cosine = (np.einsum("nij,nij->n", R @ P[:, :3, :3], Q[:, :3, :3]) - 1) / 2
    degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return PoseError(tuple(names), np.linalg.norm(moved - Q[:, :3, 3], axis=-1) / spread, degrees)


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """(scale, rotation [3, 3], translation [3]) that brings points [N, 3] closest to others: target ≈ scale · R source + t."""
    mean, mean_target = source.mean(axis=0), target.mean(axis=0)
    a, b = source - mean, target - mean_target
    U, S, Vt = np.linalg.svd(b.T @ a)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    R = U @ flip @ Vt
    scale = float((S * np.diag(flip)).sum() / np.square(a).sum())
    return scale, R, mean_target - scale * R @ mean


def _cameras(scene: Scene) -> dict[str, np.ndarray]:
    return {Path(p.name).stem: p.camera.world_T_camera for split in scene.splits.values() for p in split}


def compare(found: Path, given: Path, /) -> None:
    """Compares the cameras of two scenes of the same photographs.

    Args:
        found: Folder of a scene, such as DIR/scene of snerg-make.
        given: Folder of the scene whose cameras are taken as right.
    """
    # As seen from all around: in NDC, a reader turns and scales each scene by its own depths.
    result = pose_error(load_scene(found, spherify=True), load_scene(given, spherify=True))
    print(f"{len(result.names)} photographs in both")
    for name, unit, values in (("positions", "%", 100 * result.positions), ("rotations", "°", result.degrees)):
        numbers = ", ".join(f"{word} {value:.3f} {unit}" for word, value in
                            (("mean", values.mean()), ("median", np.median(values)), ("worst", values.max())))  # fmt: skip
        print(f"{name}: {numbers}")


if __name__ == "__main__":
    sys.exit(run_command(compare, prog="python -m tools.pose_error"))

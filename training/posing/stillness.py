"""Whether it was the camera that moved. Before a turntable it stands still, and so does the background: there, features match
with features at the same place of the picture, and what turns is outvoted.
"""

from __future__ import annotations

from typing import Any

import numpy as np

STILL = 0.003  # of the picture's longer side: matches that move less on average stand still
MOST_STILL = 0.5  # of the pairs that match; a walk has neighbours that hardly differ, but not so many


def pairs_that_stand_still(database: Any, fewest_inliers: int) -> tuple[int, int]:
    """(how many pairs of pictures match at the same place of both pictures, how many match at all), of a COLMAP database."""
    import pycolmap  # large, and the child process alone has it

    keypoints: dict[int, np.ndarray] = {}
    sides = {camera.camera_id: max(camera.width, camera.height) for camera in database.read_all_cameras()}
    side_of = {image.image_id: sides[image.camera_id] for image in database.read_all_images()}
    still = matched = 0
    for pair, inliers in zip(*database.read_two_view_geometry_num_inliers(), strict=True):
        if inliers < fewest_inliers:
            continue
        first, second = pycolmap.pair_id_to_image_pair(pair)
        for number in (first, second):
            if number not in keypoints:
                keypoints[number] = np.asarray(database.read_keypoints(number))[:, :2]
        found = database.read_two_view_geometry(first, second).inlier_matches
        moved = np.linalg.norm(keypoints[first][found[:, 0]] - keypoints[second][found[:, 1]], axis=-1)
        matched += 1
        still += bool(np.median(moved) < STILL * max(side_of[first], side_of[second]))
    return still, matched


def stands_still(still: int, matched: int) -> bool:
    """Whether so many pairs stand still that it was not the camera that moved."""
    return matched > 0 and still > MOST_STILL * matched

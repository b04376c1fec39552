"""A small pack on disk with the camera of one photograph."""

from pathlib import Path

import numpy as np
import pytest

from scenepack import save_pack
from tests.viewer.conftest import toy_pack

EYE, TARGET = (1.4, 0.9, 2.2), (0.0, -0.2, 0.0)


@pytest.fixture(scope="session")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pose = np.eye(4)
    pose[:3, 3] = (0.1, 0.2, 4.0)
    camera = {"name": "train/r_0", "split": "train", "world_T_camera": pose.tolist(), "width": 40, "height": 30}
    lens = {"fx": 50.0, "fy": 52.0, "cx": 19.0, "cy": 16.0, "distortion": [0.05, 0.0, 0.0, 0.0]}
    path = tmp_path_factory.mktemp("toy") / "toy.zip"
    save_pack(toy_pack().with_metadata(cameras=[camera | lens], provenance={"scene": "nowhere"}), path)
    return path

"""Posed photographs: readers, cameras, undistortion, downscaling. NumPy and Pillow only; no JAX here."""

from training.scenes.pixels import load_pixels
from training.scenes.read import load_scene
from training.scenes.scene import Camera, Photograph, Scene, picture_stems
from training.scenes.scene_options import SceneOptions

"""The figures that the SNeRG paper and its authors' release print, to stand beside ours in tables; never measured here.

From the paper: tables 1 to 4, and those of its appendix. RELEASE: what the authors' README reports, measured on TPUs. Of each row
the mean over a kind's scenes comes first, then its SCENES; None where nothing is printed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from training.scenes import Scene

Kind = Literal["synthetic", "forward", "real360"]
Printed = tuple[float | None, ...]
KINDS: Mapping[Kind, str] = {
    "synthetic": "its synthetic 360° scenes",
    "forward": "its real forward-facing scenes",
    "real360": "its real 360° scenes",
}
SCENES: Mapping[Kind, Sequence[str]] = {
    "synthetic": ("chair", "drums", "ficus", "hotdog", "lego", "materials", "mic", "ship"),
    "forward": ("room", "fern", "leaves", "fortress", "orchids", "flower", "trex", "horns"),
    "real360": ("spheres", "toycar", "flowers", "pinecone"),
}
# fmt: off
QUALITY: Mapping[Kind, Mapping[str, Mapping[str, Printed]]] = {
    "synthetic": {
        "psnr": {
            "AutoInt": (25.55, 25.60, 20.78, 22.47, 32.33, 25.09, 25.90, 28.10, 24.15),
            "Neural Volumes": (26.05, 28.33, 22.58, 24.79, 30.71, 26.08, 24.22, 27.78, 23.93),
            "IBRNet": (28.14, None, None, None, None, None, None, None, None),
            "NeRF": (31.00, 33.00, 25.01, 30.13, 36.18, 32.54, 29.62, 32.91, 28.65),
            "jaxnerf": (31.65, 33.88, 25.08, 30.51, 36.91, 33.24, 30.03, 34.52, 29.07),
            "NSVF": (31.74, 33.19, 25.18, 31.23, 37.14, 32.29, 32.68, 34.27, 27.93),
            "jaxnerf-plus": (33.00, 35.35, 25.65, 32.77, 37.58, 35.35, 30.29, 36.52, 30.48),
            "tinyview": (31.65, 34.24, 25.06, 29.52, 36.75, 34.34, 29.17, 34.31, 29.84),
            "deferred": (30.55, 33.63, 23.73, 28.46, 35.10, 34.67, 26.74, 33.03, 29.04),
            "snerg": (30.38, 33.24, 24.57, 29.32, 34.33, 33.82, 27.21, 32.60, 27.97),
            "diffuse": (27.39, 29.95, 21.93, 22.37, 32.99, 32.17, 24.83, 28.36, 26.57),
        },
        "ssim": {
            "AutoInt": (0.911, 0.928, 0.861, 0.898, 0.974, 0.900, 0.930, 0.948, 0.852),
            "Neural Volumes": (0.893, 0.916, 0.873, 0.910, 0.944, 0.880, 0.888, 0.946, 0.784),
            "IBRNet": (0.942, None, None, None, None, None, None, None, None),
            "NeRF": (0.947, 0.967, 0.925, 0.964, 0.974, 0.961, 0.949, 0.980, 0.856),
            "jaxnerf": (0.952, 0.974, 0.927, 0.967, 0.979, 0.968, 0.952, 0.987, 0.865),
            "NSVF": (0.953, 0.968, 0.931, 0.973, 0.980, 0.960, 0.973, 0.987, 0.854),
            "jaxnerf-plus": (0.962, 0.982, 0.936, 0.980, 0.983, 0.979, 0.956, 0.991, 0.887),
            "tinyview": (0.954, 0.978, 0.925, 0.966, 0.979, 0.975, 0.946, 0.986, 0.880),
            "deferred": (0.952, 0.976, 0.922, 0.964, 0.976, 0.976, 0.939, 0.984, 0.874),
            "snerg": (0.950, 0.975, 0.929, 0.967, 0.971, 0.973, 0.938, 0.982, 0.865),
            "diffuse": (0.927, 0.951, 0.888, 0.916, 0.966, 0.968, 0.911, 0.967, 0.850),
        },
        "lpips": {
            "AutoInt": (0.170, 0.141, 0.224, 0.148, 0.080, 0.175, 0.136, 0.131, 0.323),
            "Neural Volumes": (0.160, 0.109, 0.214, 0.162, 0.109, 0.175, 0.130, 0.107, 0.276),
            "IBRNet": (0.072, None, None, None, None, None, None, None, None),
            "NeRF": (0.081, 0.046, 0.091, 0.044, 0.121, 0.050, 0.063, 0.028, 0.206),
            "jaxnerf": (0.051, 0.027, 0.070, 0.033, 0.030, 0.030, 0.048, 0.013, 0.156),
            "NSVF": (0.047, 0.043, 0.069, 0.017, 0.025, 0.029, 0.021, 0.010, 0.162),
            "jaxnerf-plus": (0.038, 0.017, 0.057, 0.018, 0.022, 0.017, 0.041, 0.008, 0.123),
            "tinyview": (0.047, 0.020, 0.079, 0.030, 0.028, 0.020, 0.051, 0.016, 0.130),
            "deferred": (0.049, 0.022, 0.069, 0.041, 0.033, 0.019, 0.052, 0.016, 0.138),
            "snerg": (0.050, 0.025, 0.061, 0.028, 0.043, 0.022, 0.052, 0.016, 0.156),
            "diffuse": (0.068, 0.048, 0.101, 0.074, 0.044, 0.024, 0.074, 0.031, 0.152),
        },
    },
    "forward": {
        "psnr": {
            "LLFF": (24.13, 28.42, 22.85, 19.52, 29.40, 18.52, 25.46, 24.15, 24.70),
            "DeRF": (24.81, 29.72, 24.87, 20.64, 26.84, 19.97, 25.66, 24.86, 25.89),
            "NeRF": (26.50, 32.70, 25.17, 20.92, 31.16, 20.36, 27.40, 26.80, 27.45),
            "IBRNet": (26.73, None, None, None, None, None, None, None, None),
            "jaxnerf": (26.92, 33.30, 24.92, 21.24, 31.78, 20.32, 28.09, 27.43, 28.29),
            "jaxnerf-plus": (26.95, 33.79, 24.38, 20.82, 31.14, 20.09, 28.34, 27.94, 29.08),
            "deferred": (26.61, 32.63, 24.88, 20.67, 31.28, 19.72, 27.40, 27.72, 28.56),
            "snerg": (25.63, 30.04, 24.85, 20.01, 30.91, 19.73, 27.00, 25.80, 26.71),
            "diffuse": (26.31, 31.44, 24.98, 20.64, 30.46, 19.89, 26.95, 28.06, 28.03),
        },
        "ssim": {
            "LLFF": (0.798, 0.932, 0.753, 0.697, 0.872, 0.588, 0.844, 0.857, 0.840),
            "DeRF": (0.767, 0.930, 0.770, 0.680, 0.730, 0.610, 0.790, 0.840, 0.790),
            "NeRF": (0.811, 0.948, 0.792, 0.690, 0.881, 0.641, 0.827, 0.880, 0.828),
            "IBRNet": (0.851, None, None, None, None, None, None, None, None),
            "jaxnerf": (0.831, 0.958, 0.806, 0.717, 0.897, 0.657, 0.850, 0.902, 0.863),
            "jaxnerf-plus": (0.845, 0.966, 0.813, 0.724, 0.900, 0.669, 0.868, 0.921, 0.898),
            "deferred": (0.837, 0.957, 0.816, 0.720, 0.901, 0.657, 0.844, 0.913, 0.886),
            "snerg": (0.818, 0.936, 0.802, 0.696, 0.889, 0.655, 0.835, 0.882, 0.852),
            "diffuse": (0.832, 0.947, 0.821, 0.715, 0.891, 0.656, 0.827, 0.916, 0.883),
        },
        "lpips": {
            "LLFF": (0.212, 0.155, 0.247, 0.216, 0.173, 0.313, 0.174, 0.222, 0.193),
            "DeRF": (0.274, 0.160, 0.300, 0.310, 0.320, 0.340, 0.240, 0.220, 0.300),
            "NeRF": (0.250, 0.178, 0.280, 0.316, 0.171, 0.321, 0.219, 0.249, 0.268),
            "IBRNet": (0.175, None, None, None, None, None, None, None, None),
            "jaxnerf": (0.173, 0.086, 0.207, 0.247, 0.108, 0.266, 0.156, 0.143, 0.173),
            "jaxnerf-plus": (0.145, 0.066, 0.176, 0.233, 0.097, 0.238, 0.124, 0.113, 0.119),
            "deferred": (0.160, 0.090, 0.186, 0.240, 0.097, 0.256, 0.149, 0.125, 0.134),
            "snerg": (0.183, 0.133, 0.198, 0.252, 0.125, 0.255, 0.167, 0.157, 0.176),
            "diffuse": (0.164, 0.115, 0.182, 0.241, 0.105, 0.251, 0.166, 0.116, 0.133),
        },
    },
    "real360": {
        "psnr": {
            "jaxnerf-plus": (24.56, 23.56, 26.13, 25.22, 23.33),
            "deferred": (24.31, 23.44, 26.16, 24.81, 22.81),
            "snerg": (23.97, 23.16, 26.17, 24.43, 22.14),
            "diffuse": (24.02, 23.26, 26.17, 24.23, 22.42),
        },
        "ssim": {
            "jaxnerf-plus": (0.703, 0.573, 0.792, 0.765, 0.681),
            "deferred": (0.693, 0.563, 0.787, 0.754, 0.666),
            "snerg": (0.662, 0.521, 0.788, 0.746, 0.595),
            "diffuse": (0.681, 0.565, 0.788, 0.728, 0.645),
        },
        "lpips": {
            "jaxnerf-plus": (0.248, 0.311, 0.195, 0.227, 0.257),
            "deferred": (0.261, 0.320, 0.209, 0.244, 0.271),
            "snerg": (0.293, 0.357, 0.209, 0.272, 0.336),
            "diffuse": (0.260, 0.306, 0.200, 0.257, 0.277),
        },
    },
}
# Table 2 (and 3): rows of synthetic scenes that are printed as means only.
QUALITY_MEANS: Mapping[str, tuple[float, float, float]] = {
    "float": (30.47, 0.951, 0.049),
    "no-sparsity": (30.22, 0.949, 0.050),
    "8-bit": (26.68, 0.930, 0.053),
}
# PSNR, SSIM, LPIPS, MB of table 3 and the appendix's storage table.
STORAGE: Mapping[Kind, Mapping[str, tuple[float, float, float, float]]] = {
    "synthetic": {
        "float": (30.47, 0.951, 0.049, 6883.6), "no-sparsity": (30.22, 0.949, 0.050, 176.0),
        "png": (30.38, 0.950, 0.050, 86.7), "jpeg": (29.71, 0.939, 0.062, 70.9), "h264": (29.86, 0.938, 0.065, 30.2),
        "jaxnerf-plus": (33.00, 0.962, 0.038, 18.0), "jaxnerf": (31.65, 0.952, 0.051, 4.8),
    },
    "forward": {
        "float": (25.74, 0.823, 0.180, 13830.3), "png": (25.63, 0.818, 0.183, 373.2),
        "jpeg": (25.27, 0.781, 0.232, 183.3), "h264": (25.13, 0.761, 0.257, 66.9),
        "jaxnerf-plus": (26.95, 0.845, 0.145, 18.0),
    },
    "real360": {
        "float": (24.05, 0.661, 0.299, 7238.3), "png": (23.97, 0.662, 0.293, 264.7),
        "jpeg": (23.67, 0.638, 0.306, 129.2), "h264": (23.60, 0.629, 0.316, 51.3),
        "jaxnerf-plus": (24.56, 0.703, 0.248, 18.0),
    },
}
# Table 1 and the appendix: milliseconds a frame and GB on the graphics card, on a laptop with an 85 W AMD Radeon Pro 5500M.
MILLISECONDS: Mapping[str, Printed] = {
    "ours": (11.9, 9.8, 9.6, 21.1, 7.2, 9.3, 10.1, 10.1, 17.9),
    "no-mlp": (9.2, 6.6, 6.6, 19.4, 5.3, 6.0, 7.8, 7.6, 14.0),
    "no-sparsity": (20.0, 15.3, 15.7, None, 24.4, 25.4, 19.7, 12.6, 27.0),
    "mlp-per-sample": (343.6, 269.8, 268.9, 987.9, 155.8, 261.4, 262.2, 222.6, 320.4),
}
GPU_GB: Mapping[str, Printed] = {
    "ours": (1.73, 0.78, 0.86, 4.99, 0.53, 0.74, 0.98, 1.18, 3.78),
    "no-mlp": (1.73, 0.78, 0.86, 4.99, 0.53, 0.74, 0.98, 1.18, 3.78),
    "no-sparsity": (4.26, 2.44, 3.25, 7.57, 4.17, 3.68, 4.91, 2.33, 5.77),
    "mlp-per-sample": (1.73, 0.78, 0.86, 4.99, 0.53, 0.74, 0.98, 1.18, 3.78),
}
# Frames per second of the real scenes, in the order of SCENES, without a mean.
REAL_FPS: Mapping[Kind, Sequence[float]] = {
    "forward": (37.09, 26.73, 19.02, 39.16, 18.54, 26.58, 34.78, 34.02),
    "real360": (53.7, 41.1, 40.8, 39.5),
}
# PSNR, SSIM, LPIPS, FPS, MB of the appendix's table of resolutions.
RESOLUTION: Mapping[int, tuple[float, float, float, float, float]] = {
    1000: (30.38, 0.950, 0.050, 84.06, 86.7),
    750: (29.94, 0.947, 0.054, 89.82, 44.7),
    500: (28.93, 0.939, 0.064, 101.78, 17.8),
}
# Watts, FPS and FPS per watt of table 4 and of the appendix's table of forward-facing scenes.
SPEED: Mapping[Kind, Mapping[str, tuple[float, float, float]]] = {
    "synthetic": {
        "jaxnerf-plus": (300, 0.01, 0.00002), "NeRF": (300, 0.03, 0.00011), "jaxnerf": (300, 0.05, 0.00016),
        "IBRNet": (300, 0.18, 0.00061), "AutoInt": (300, 0.38, 0.00128), "NSVF": (300, 0.65, 0.00217),
        "Neural Volumes": (300, 3.33, 0.01111), "snerg": (85, 84.06, 0.98897),
    },
    "forward": {
        "jaxnerf-plus": (300, 0.00, 0.00001), "DeRF": (300, 0.03, 0.00009), "NeRF": (300, 0.03, 0.00011),
        "jaxnerf": (300, 0.04, 0.00013), "IBRNet": (300, 0.18, 0.00061), "LLFF": (250, 60.00, 0.24000),
        "snerg": (85, 27.38, 0.32210),
    },
    "real360": {},
}
RELEASE: Mapping[Kind, Mapping[str, Printed]] = {
    "synthetic": {
        "deferred": (31.77, 34.96, 24.05, 28.93, 35.69, 36.35, 29.63, 34.02, 30.54),
        "snerg": (31.00, 34.25, 24.47, 29.30, 34.91, 34.66, 28.44, 32.79, 29.19),
    },
    "forward": {
        "deferred": (26.57, None, 24.69, None, None, None, None, None, None),
        "snerg": (25.83, None, 24.93, None, None, None, None, None, None),
    },
    "real360": {},
}
# fmt: on
NAMES: Mapping[str, str] = {
    "jaxnerf-plus": "JAXNeRF+",
    "jaxnerf": "JAXNeRF",
    "tinyview": "JAXNeRF+ Tinyview",
    "deferred": "JAXNeRF+ Deferred",
    "diffuse": "JAXNeRF+ Diffuse",
    "snerg": "SNeRG (PNG)",
}  # fmt: skip


def kind_of(scene: Scene) -> Kind:
    """To which of the paper's kinds of scenes one belongs."""
    return "forward" if scene.ndc else "synthetic" if scene.kind == "blender" else "real360"


def place_of(kind: Kind, name: str) -> int:
    """Where a scene of this name stands in rows of its kind; 0, the mean, where the paper has no such scene."""
    plain = name.lower().replace("_", "").replace("-", "").replace(" ", "")
    return 1 + SCENES[kind].index(plain) if plain in SCENES[kind] else 0


def whose(kind: Kind, name: str) -> str:
    """Of what the paper's figures are that stand beside those of a scene."""
    return f"the same scene, {name}" if place_of(kind, name) else f"the mean of {KINDS[kind]}"


def quality(kind: Kind, name: str, row: str) -> dict[str, float | None] | None:
    """psnr, ssim, lpips of a row of the paper's quality tables, for a scene or its kind's mean. None where it has none."""
    place = place_of(kind, name)
    if row in QUALITY_MEANS:
        return dict(zip(("psnr", "ssim", "lpips"), QUALITY_MEANS[row], strict=True)) if kind == "synthetic" else None
    if row not in QUALITY[kind]["psnr"]:
        return None
    return {metric: rows[row][place] for metric, rows in QUALITY[kind].items()}


def release(kind: Kind, name: str, row: str) -> float | None:
    """PSNR of a row as the release reports it."""
    rows = RELEASE[kind]
    return rows[row][place_of(kind, name)] if row in rows else None


def performance(kind: Kind, name: str, row: str) -> dict[str, float | None] | None:
    """ms and gpu_gb of a row of table 1; fps where only that is printed."""
    place = place_of(kind, name)
    if kind == "synthetic" and row in MILLISECONDS:
        return {"ms": MILLISECONDS[row][place], "gpu_gb": GPU_GB[row][place]}
    if kind != "synthetic" and row == "ours" and place:
        return {"fps": REAL_FPS[kind][place - 1]}
    return None


def only_means(row: str) -> bool:
    """Whether the paper prints this row as a mean over scenes alone, even beside a scene that it knows."""
    return row in QUALITY_MEANS


def storage(kind: Kind, row: str) -> dict[str, Any] | None:
    """psnr, ssim, lpips and mb of a row of the storage tables; means over a kind's scenes."""
    printed = STORAGE[kind].get(row)
    return None if printed is None else dict(zip(("psnr", "ssim", "lpips", "mb"), printed, strict=True))

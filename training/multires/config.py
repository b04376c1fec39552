"""Settings of the multi-resolution field.

What a field needs depends on what was photographed. A setting whose default is None is taken from BY_KIND:

    object        cut out by alpha: all else is known to be empty
    surroundings  opaque photographs from many sides: every ray must end somewhere, and much is seen by few photographs
    unbounded     the same, all of space contracted into the cube
    forward       opaque photographs from one side, in NDC: depth is disparity, which small baselines tell coarsely
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from training.scenes.scene import Kind


@dataclass(frozen=True)
class MultiresConfig:
    """The multi-resolution field (training.multires). Resolutions are cells along each axis of the unit cube around the scene."""

    resolutions: tuple[int, ...] | None = None
    """Cells along the cube of each level, coarse to fine. None: powers of two from 16 to about the photographs' pixels, at most
    512, in contracted space to four times as many, at most 2048; and three quarters of the finest."""
    occupancy: int = 256
    """Cells of the occupancy grid along the cube; a multiple of 8."""
    occupancy_threshold: float = 0.01
    """Optical depth over 1/512 of the cube from which a cell is occupied."""
    finest_from: float | None = None
    """When the finest level joins, and others of more than half its cells, as a fraction of all steps. None: a quarter; in
    forward-facing scenes, which are sharper then, a twentieth: enough to find most empty space, for which no rows are kept. Here
    and below, None means: chosen by the kind of scene, but where something else is said."""
    samples_per_step: int | None = None
    """Samples per step, without those in empty space. The number of rays adapts to it. None: from 32,768 for small photographs
    to 131,072 for those of 512 pixels and more, in contracted space and in forward-facing scenes of 1,024."""
    steps_across: tuple[int, ...] | None = None
    """Samples along the cube's side: at first, and after each of steps_from. None: half as many as the finest level has cells, as
    many, at last twice as many, of all of them fewer where ndc_depth is below 2; in contracted space an eighth, a quarter, half,
    at last as many, of at most 1024."""
    steps_from: tuple[float, ...] | None = None
    """When samples lie closer, as fractions of all steps. None: (0.25, 0.85), in contracted space (0.25, 0.6, 0.85)."""
    view_octaves: int | None = None
    """Octaves of the view direction that the view MLP sees, at most 4."""
    view_dependence: bool = True
    """If false, train a diffuse model without a view MLP."""
    table_rate: float = 0.015
    """Initial learning rate of features (Adam)."""
    decoder_rate: float = 5e-3
    """Initial learning rate of the decoder (Adam)."""
    view_rate: float = 3e-3
    """Initial learning rate of the view MLP (Adam)."""
    final_rate_factor: float | None = None
    """All learning rates fall log-linearly to this fraction at the last step. The field is the mean of 20 states of the last
    fifth of the run, so that large steps do no harm to the end."""
    warmup_steps: int = 20
    """Steps over which learning rates rise from zero."""
    distortion_weight: float | None = None
    """Weight of the distortion loss of mip-NeRF 360, with distances relative to the cube; 0 for none."""
    sparsity_factor: float | None = None
    """Factor on the sparsity weight."""
    feature_decay: float | None = None
    """Weight of the mean square of each level's features, summed over levels (Zip-NeRF, Barron et al. 2023); 0 for none. It falls
    log-linearly to a twentieth, so that it does not keep long runs from learning fine detail."""
    density_smoothness: float | None = None
    """Weight of the squared difference of density between neighbouring points, as ln(1 + optical depth of a cell); 0 for none."""
    colour_smoothness: float | None = None
    """The same of colours and features."""
    least_views: int | None = None
    """Space that fewer training photographs see is empty; a quarter of all photographs always suffices."""
    ndc_depth: float | None = None
    """Depth of a cell relative to its width, in forward-facing scenes. None: from 1 to 4, so that front and back of a cell
    of the finest level lie 0.6 pixels apart in photographs taken from other places."""
    random_background: bool = True
    """Train what is cut out before random colours instead of the scene's own: mist of the background's colour costs nothing
    before it. Opaque photographs always have random colours behind them."""


@dataclass(frozen=True)
class KindSettings:
    """The settings of MultiresConfig that the kind of scene decides where nobody else does; explained there."""

    distortion_weight: float
    sparsity_factor: float
    least_views: int
    finest_from: float = 0.25
    view_octaves: int = 1
    final_rate_factor: float = 0.2
    feature_decay: float = 0.0
    density_smoothness: float = 0.0
    colour_smoothness: float = 0.0


BY_KIND: Mapping[Kind, KindSettings] = {
    "object": KindSettings(distortion_weight=0.05, sparsity_factor=1.0, least_views=6, feature_decay=0.1),
    "surroundings": KindSettings(distortion_weight=0.01, sparsity_factor=2.0, least_views=6),
    "unbounded": KindSettings(
        distortion_weight=0.05, sparsity_factor=1.0, least_views=1, view_octaves=2, final_rate_factor=0.4
    ),
    "forward": KindSettings(
        distortion_weight=0.05, sparsity_factor=0.2, least_views=1, finest_from=0.05, feature_decay=1.0,
        density_smoothness=0.01, colour_smoothness=0.1,
    ),
}  # fmt: skip
# From which fraction of all steps on, samples along the cube's side, over the cells of the finest level; of contracted space few
# at first, for what lies far away is not seen finely
SAMPLES_ACROSS = (0.0, 0.5), (0.25, 1.0), (0.85, 2.0)
CONTRACTED_SAMPLES_ACROSS = (0.0, 0.125), (0.25, 0.25), (0.6, 0.5), (0.85, 1.0)


def settings_for(config: MultiresConfig, kind: Kind) -> KindSettings:
    """What the config says, and what suits the kind of scene where it says None."""
    said = {field.name: getattr(config, field.name) for field in dataclasses.fields(KindSettings)}
    return dataclasses.replace(BY_KIND[kind], **{name: value for name, value in said.items() if value is not None})

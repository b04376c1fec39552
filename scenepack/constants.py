"""Numbers that Python and GLSL share, and numbers of packages that may import nothing else of one another.

Python owns them; shaders receive them as #define (see viewer.rendering.shader_source).
Source: docs/rendering.md and docs/format.md; SNeRG paper sections 5.1-5.5 and appendices A and C.3.
"""

from typing import Literal

CodecName = Literal["png", "webp", "jpeg", "h264", "avif"]  # as commands name them; see scenepack.codecs.CODECS

ALPHA_CONTRIBUTES = 0.5 / 255.0  # a sample contributes where its interpolated alpha exceeds this
TRANSMITTANCE_STOP = 1.0 / 255.0  # the march stops at T <= this
TRANSMITTANCE_SHADED = 254.0 / 255.0  # the view MLP is asked where T <= this
UNPREMULTIPLY_GAIN = 1.5  # forward-facing packs: times min(1, 1.5 A) / A (appendix C.3)
NDC_NEAR = 1.0  # near plane of the NDC warp, in scene units
# Width, height and focal length (pixels) that the published viewer assumes where a forward-facing pack has no input_focal:
# the camera of the paper's own LLFF captures.
PUBLISHED_NDC_CAMERA = (1006.0, 756.0, 755.644059435)

FEATURES = 4  # channels of the feature vector v_s
VIEW_FREQUENCIES = 4  # sin(2^0 v) ... sin(2^3 v)
VIEW_ENCODING = 3 + 2 * 3 * VIEW_FREQUENCIES  # 27
VIEW_MLP_WIDTHS = (VIEW_ENCODING + 3 + FEATURES, 16, 16, 3)  # 34 -> 16 -> 16 -> 3

EMPTY_BLOCK = 255  # in the indirection grid
MAX_BLOCK_INDEX = 254  # the largest atlas block coordinate a byte can hold
PLANES_PER_IMAGE = 4  # z-planes of the atlas stacked in one rgba_NNN.png / feature_NNN.png

"""The pack: a baked scene in memory and on disk (docs/format.md; SNeRG paper section 5.1).

One reader (`load_pack`, `open_pack`), one writer (`save_pack`), cutting volumes into macroblocks
(`blocks`), a validation report (`check_pack`), and the constants that Python and GLSL share (`constants`).
"""

from scenepack.check import Finding, check_pack
from scenepack.pack import Pack, PackWarning, ViewMlp
from scenepack.reader import PackReader, load_pack, open_pack
from scenepack.writer import check_target, save_pack

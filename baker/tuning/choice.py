"""What may be tuned after baking, as the options of commands name it."""

from typing import Literal

FineTune = Literal["auto", "none", "view-mlp", "all", "compact"]

"""The panels: what is drawn over and beside the picture, with Dear ImGui. The only folder that imports imgui_bundle.

Panels draw the state of viewer.app and call its commands; they hold none of their own. `ui.Ui` draws them all.
"""

from viewer.panels.any_text import take_any_text

take_any_text()

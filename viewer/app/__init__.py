"""What the viewer knows and can do, as plain Python: no OpenGL, no imgui, no window.

Panels draw this state and call its commands; tests drive it without either. `application.App` is the whole of it.
"""

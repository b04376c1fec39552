"""Camera poses of bare photographs and films, by COLMAP's pipeline (pycolmap): an ordinary COLMAP scene. No JAX here.

training.scenes.sources says what lies in a folder. find.find_poses goes from there to a scene, in stages that a killed
process is taken up from: pictures (prepare, photograph, film), then features, matches and poses (mapping), which run in a
child process (child_process), since Ctrl-C cannot reach into COLMAP. check says what photographs are worth; depths finds how
near things are in scenes that come with poses alone.
"""

"""One file = one scene; the file name is the scene's name and the file defines `SCENE`."""

"""Scenes: one file each, named like its scene; the file defines `SCENE`."""

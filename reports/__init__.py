"""How it is told: HTML from stored records alone.

No solver, no scene, nothing of the other rooms is imported.
"""

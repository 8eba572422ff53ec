"""How it is told: HTML from stored records alone; no solver, no scene, nothing of the other rooms is imported."""

"""ONE FILE = ONE STRATEGY: how the pairs are made smooth."""

def build(report): return None

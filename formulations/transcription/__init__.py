"""Transcribe a scene into a Pyomo model of the whole plan, and solve it by stages.

    model = build_model("three_cart", contact=ContactFormulation.SOFTPLUS, eps=1e-3)

Models: `build` (components, plans in and out), `equations`, `contact` (laws and relaxations),
`collocation`, `residuals`. Solves: `method` (options, rules, budget), `compiled` (the model for
Ipopt), `solving` (one stage), `homotopy` (stages of decreasing eps).
"""

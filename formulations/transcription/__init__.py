"""Scene -> Pyomo model of a whole plan: variables, one constraint an equation, contact laws, objective. The only Pyomo of the plan is here.

    from formulations import ContactFormulation, build_model
    model = build_model("three_cart", contact=ContactFormulation.SOFTPLUS, eps=1e-3)

`build` says what a model holds and how a plan gets in and out, `equations` what it says, `contact`
how it is relaxed and how tightly, `residuals` how far a plan is from its equations.

What a method in formulations/methods is put together from: `method` its options, the rules of a
stage and what it spends, `compiled` the model as Ipopt takes it, `solving` the model loaded,
solved, read and checked, what is left once contact modes are fixed, and whether the goal can be
reached at all, `homotopy` stages for ever smaller eps.
"""

"""How a plan is found: methods, the pipelines that chain them, and the Pyomo models they are built from.

    from formulations import build_model, ContactLaw
    model = build_model("three_cart", ContactLaw.COMPLEMENTARITY)     # a plain pyomo ConcreteModel

Pyomo is imported when a model is built, PyTorch when a shooting method runs: importing this package costs neither.
"""

"""Campaign files: TOML -> what a campaign runs. Every mistake of a file is told at once, with its place.

from validate.plan.read import read_campaign

campaign = read_campaign(Path("stiffness.toml"))
run_campaign(Settings(out=out, **campaign.settings()), narrator)
"""

"""Campaign files: TOML -> what a campaign runs. Every mistake of a file is told at once, with its place.

campaign = read_campaign(Path("stiffness.toml"))
run_campaign(Settings(out=out, **campaign.settings()), narrator)
"""

from validate.plan.read import Campaign, ConfigError, read_campaign
from validate.plan.schema import CampaignFile

__all__ = ["Campaign", "CampaignFile", "ConfigError", "read_campaign"]

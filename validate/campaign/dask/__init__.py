"""Run tasks of a campaign on the workers of a Dask cluster: local processes, or a standing one.

`--engine dask`, `dask:ADDRESS` or `dask:FILE.json`; validate.campaign.engine has the table.
"""

from validate.campaign.dask.engine import DASK_KIND, DaskEngine, local_cluster, open_dask

__all__ = ["DASK_KIND", "DaskEngine", "local_cluster", "open_dask"]

"""Everything that drives: floors and lattices, planners, smooth drives, controllers, and what failing bases do.

Rooms below know this one by contracts: `costs.models.failing_base`, `constraints.base_limits`,
`query.endpoints.base_goals` and `query.driving`. They import it once a scene has a base (`scene.mobile.room`).
"""

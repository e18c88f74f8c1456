"""Mobile bases: floors and lattices, planners, smooth drives, controllers, and models of failing bases.

Lower-level packages use this one only through contracts: `costs.models.failing_base`, `constraints.base_limits`,
`query.endpoints.base_goals` and `query.driving`. They import it on demand, when a scene has a base
(`scene.mobile.optional`).
"""

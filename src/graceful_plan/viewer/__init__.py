"""Browser view of a scene and its motions. The displayed state is independent of viser.

From the bottom: `shapes` and `poses` contain the geometry of bodies and their poses; `shown`, `fall` and `risk_layer`
the data of a motion and of one of its moments; `question` a planning request and its changes; `worker` answers only the
latest request; `failing` simulates failures; `state` combines all of this.
"""

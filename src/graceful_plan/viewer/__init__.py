"""A scene and its motions in a browser. The state of what is shown knows nothing of viser.

From the bottom: `shapes` and `poses` say what things look like and where they are; `shown`, `fall` and `risk_layer`
what is known of a motion and of one of its moments; `question` is what is asked of the planner and how it is changed,
`worker` answers the latest question only, `failing` simulates failures; `state` holds all of it.
"""

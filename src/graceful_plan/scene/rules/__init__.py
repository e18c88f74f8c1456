"""What may be asked of motions in a scene, as plain facts about its frames: for planners and judge alike."""

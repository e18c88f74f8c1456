"""The page: draws a `ViewerState`. Only these modules know of viser, which is imported when a page is opened."""

"""The page, which draws a `ViewerState`. Only these modules use viser, imported when a page is opened."""

"""One module a subject: TITLE, and run(options), which measures and returns Markdown."""

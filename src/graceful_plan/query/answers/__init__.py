"""From ends to a result: search, time, judge, and again more cautiously."""

"""Types, errors, onsets, tables and statistics that all parts of FailBench use."""

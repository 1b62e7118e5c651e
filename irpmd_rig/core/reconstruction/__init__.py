"""From phases to heights and points."""

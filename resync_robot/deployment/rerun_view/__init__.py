"""A recording as Rerun shows it. The only package that knows Rerun."""

"""From a depth map to facets, planes and steps."""

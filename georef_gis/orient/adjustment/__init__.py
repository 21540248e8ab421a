"""One-step adjustment: poses, cameras, mounts, clocks, ground points and control together."""

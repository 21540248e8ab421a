"""From files and ports to the model: photos, cameras, poses, control."""

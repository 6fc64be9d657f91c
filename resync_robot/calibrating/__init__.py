"""What `resync-robot calibrate` does at a machine: pictures, poses, noise, colours, and the verdict."""

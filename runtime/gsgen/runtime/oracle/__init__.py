"""What should the renderer draw? Float64 references of each kind of picture."""

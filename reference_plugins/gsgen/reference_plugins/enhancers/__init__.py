"""Which networks restore or enlarge rendered images? Real-ESRGAN, SwinIR, NAFNet."""

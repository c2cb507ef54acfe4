"""Body models, motions and skinning, which all plugins of people share."""

"""Which published networks redraw the rendered image in a style? Fast neural style, AdaIN, AnimeGANv2."""

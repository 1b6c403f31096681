"""Where objects and views come from: generators, other people's models, ArtImage, the renderer."""

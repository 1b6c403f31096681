"""Mathematics without objects: transforms, kinematic trees, cameras and lenses, meshes, least squares."""

"""eitskin: physics, learning and diagnosis of EIT tactile skins."""

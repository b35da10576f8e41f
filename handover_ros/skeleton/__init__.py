"""The person's skeleton; so far the torso, as a rigid body that carries markers."""

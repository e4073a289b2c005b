"""Motor, rigid body, battery, vehicle profiles and the model file. Pure."""

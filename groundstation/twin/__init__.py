"""The live twin: an identified model that flies beside the craft and says where they disagree."""

"""What drives are asked to do in the field: one file a topic, each with its `OPERATIONS`."""

"""Contact as physics: what touches in a world, and the change of motion that follows from it."""

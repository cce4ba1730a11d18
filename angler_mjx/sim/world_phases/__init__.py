"""What goes on aboard the robots of a world before their controllers act."""

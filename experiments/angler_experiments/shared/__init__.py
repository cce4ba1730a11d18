"""Common parts of studies: driving, flights, integration schemes, tracing."""

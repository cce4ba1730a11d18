"""Control of real autopilots by our own controllers."""

"""Tasks of a fleet: visits, surveys and deliveries, their allocation, and the robots' beliefs."""

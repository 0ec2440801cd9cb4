"""Forces of the wheels along a motion that is given: by the balance of the rover, and with their uncertainty."""

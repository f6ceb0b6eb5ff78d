"""What `pcpc fit` estimates of the motor from a log, and against what.

The model's encoder rounds to counts, which has no slope: the counts are compared with the angle.
"""

PARAMETERS = {
    "motor.torque_constant_Nm_A": "a move",
    "motor.resistance_ohm": "a move",
    "motor.inertia_kg_m2": "a fast move",
    "motor.viscous_Nms_rad": "a long move at speed",
    "motor.coulomb_Nm": "a move that ends at rest",
}
SENSORS = {"FB.encoder": "motor.angle_rad", "FB.current": "motor.sample_current_A"}

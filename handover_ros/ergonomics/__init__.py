"""What a posture costs a person: body segments and their weight, cost functions, and the postures they predict."""

"""What a vehicle is: rotor layout, mass, filters, propellers, balance."""

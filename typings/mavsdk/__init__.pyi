# What the tests use of mavsdk 4.1, which ships no types.

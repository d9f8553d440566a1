//! Wire formats, serial DAQ link and CANopen drive of the shaketable controller, with emulators of
//! both devices.

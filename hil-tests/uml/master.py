"""A CANopen master on `canopen` and `python-can` that takes the emulated drive through its states: a peer that shares no
code with the product.

usage: master.py INTERFACE NODE. Ends with exit code 0 and one JSON object, or with an exception.
"""
import json
import sys
import time

import canopen
from canopen.profiles.p402 import BaseNode402
import od

INTERFACE, NODE = sys.argv[1], int(sys.argv[2])
network = canopen.Network()
network.connect(interface="socketcan", channel=INTERFACE)
node = BaseNode402(NODE, od.drive(NODE))
network.add_node(node)
emergencies = []
node.emcy.add_callback(lambda error: emergencies.append(error.code))

node.nmt.send_command(0x82)
node.nmt.wait_for_bootup(5)
result = {"name": node.sdo[0x1008].raw, "vendor": node.sdo[0x1018][1].raw, "profile": node.sdo[0x1000].raw & 0xFFFF}

# Refusals that the standard asks for.
aborts = {}
for label, action in (("read-only", lambda: setattr(node.sdo[0x6041], "raw", 0)),
                      ("mode", lambda: setattr(node.sdo[0x6060], "raw", 3)),
                      ("missing", lambda: node.sdo.upload(0x5FFF, 0))):
    try:
        action()
        aborts[label] = None
    except canopen.SdoAbortedError as error:
        aborts[label] = error.code
result["aborts"] = aborts

node.sdo[0x6060].raw = 8
node.sdo[0x6085].raw = 5_000_000
node.sdo[0x605A].raw = 6
node.sdo[0x1017].raw = 100
node.rpdo.read()
node.tpdo.read()
node.rpdo[1].clear()
node.rpdo[1].add_variable(0x6040)
node.rpdo[1].add_variable(0x607A)
node.rpdo[1].trans_type, node.rpdo[1].enabled = 1, True
node.rpdo[1].save()
# Another mapping than the product's own master uses.
node.tpdo[1].clear()
node.tpdo[1].add_variable(0x6064)
node.tpdo[1].add_variable(0x6041)
node.tpdo[1].trans_type, node.tpdo[1].enabled = 1, True
node.tpdo[1].save()
result["mapped"] = [node.sdo[0x1A00][1].raw, node.sdo[0x1600][2].raw]

node.nmt.state = "OPERATIONAL"
network.sync.start(0.01)
node.rpdo[1].start(0.01)
node.setup_402_state_machine(read_pdos=False)
states = []
for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
    node.state = state
    states.append(node.state)
# A ramp of 2 mm at 10 mm/s or so in the drive's counts, 0.1 um each.
position = []
for k in range(1, 21):
    node.rpdo[1][0x607A].raw = 1000 * k
    node.tpdo[1].wait_for_reception(1)
    position.append(node.tpdo[1][0x6064].raw)
time.sleep(0.3)
node.tpdo[1].wait_for_reception(1)
result["position"] = node.tpdo[1][0x6064].raw
node.state = "QUICK STOP ACTIVE"
states.append(node.state)
node.state = "SWITCH ON DISABLED"
states.append(node.state)
# Enabled again, then the master falls silent: the drive must stop by itself and say why.
node.sdo[0x6007].raw = 3
node.sdo[0x1016][1].raw = 126 << 16 | 40
network.send_message(0x700 + 126, [5])
for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
    network.send_message(0x700 + 126, [5])
    node.state = state
deadline = time.monotonic() + 2
while not emergencies and time.monotonic() < deadline:
    time.sleep(0.005)
node.tpdo[1].wait_for_reception(1)
states.append(node.state)
result["states"] = states
result["emergencies"] = emergencies
result["heartbeat_state"] = node.nmt.state
node.rpdo[1].stop()
network.sync.stop()
network.disconnect()
print(json.dumps(result))

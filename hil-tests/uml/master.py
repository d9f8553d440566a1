"""A CANopen master on `canopen` and `python-can` that takes the emulated drive through its states: a peer that shares no
code with the product.

usage: master.py INTERFACE NODE. Ends with exit code 0 and one JSON object, or with an exception.
"""
import json
import sys
import threading
import time

import canopen
from canopen.profiles.p402 import BaseNode402
import od

INTERFACE, NODE = sys.argv[1], int(sys.argv[2])
HOST = 0x700 + 126
# What is tested is the exchange, not how fast this interpreter is on a busy machine.
BaseNode402.TIMEOUT_CHECK_TPDO = BaseNode402.TIMEOUT_SWITCH_STATE_SINGLE = 5
BaseNode402.TIMEOUT_SWITCH_STATE_FINAL = 10


def until(what, condition, timeout=10):
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"waited in vain until {what}")


network = canopen.Network()
network.connect(interface="socketcan", channel=INTERFACE)
node = BaseNode402(NODE, od.drive(NODE))
network.add_node(node)
emergencies = []
node.emcy.add_callback(lambda error: emergencies.append(error.code))

# Heard from before the command is sent: `wait_for_bootup` misses an answer that comes before it listens.
node.sdo.RESPONSE_TIMEOUT = 5
booted = threading.Event()
node.nmt.add_heartbeat_callback(lambda state: booted.set() if state == 0 else None)
node.nmt.send_command(0x82)
if not booted.wait(10):
    raise TimeoutError("no boot-up message")
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
for k in range(1, 21):
    node.rpdo[1][0x607A].raw = 1000 * k
    node.tpdo[1].wait_for_reception(5)


def arrived():
    node.tpdo[1].wait_for_reception(5)
    return abs(node.tpdo[1][0x6064].raw - 20_000) < 20


until("the drive is where it was sent", arrived)
result["position"] = node.tpdo[1][0x6064].raw
node.state = "QUICK STOP ACTIVE"
states.append(node.state)
node.state = "SWITCH ON DISABLED"
states.append(node.state)
# Enabled again under a heartbeat, then the master falls silent: the drive must stop by itself and say why.
node.sdo[0x6007].raw = 3
node.sdo[0x1016][1].raw = 126 << 16 | 400
heartbeat = network.send_periodic(HOST, [5], 0.02)
for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
    node.state = state
result["emergencies_before"] = list(emergencies)
heartbeat.stop()
until("the lost heartbeat is told", lambda: node.tpdo[1].wait_for_reception(5) and emergencies)


def stopped():
    node.tpdo[1].wait_for_reception(5)
    return node.state == "QUICK STOP ACTIVE"


until("the drive stops by itself", stopped)
states.append(node.state)
result["states"] = states
result["emergencies"] = emergencies
result["heartbeat_state"] = node.nmt.state
node.rpdo[1].stop()
network.sync.stop()
network.disconnect()
print(json.dumps(result))

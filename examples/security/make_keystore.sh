#!/bin/sh
# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
# Makes the keystore of an arm for SROS 2, with the enclaves that `bringup` and the launch files use:
#   make_keystore.sh KEYSTORE ARM JOINT...      (with the ROS_DOMAIN_ID of the nodes)
# ARM is the name of the arm with its namespace, if there is one: cell1/five_axis.
# Needs an official Jazzy with its package sros2, and posor_bringup, sourced. An existing keystore is kept: only what is
# missing is created, and the permissions are signed anew.
set -eu

if [ $# -lt 3 ]; then
    echo "make_keystore.sh: $# arguments; expected KEYSTORE ARM JOINT..., such as: keys five_axis shoulder elbow" >&2
    exit 2
fi
if ! command -v ros2 >/dev/null; then
    echo "make_keystore.sh: the command ros2 is missing; expected an official Jazzy with sros2, sourced" >&2
    exit 1
fi
keystore=$1 arm=$2
shift 2
for name in "$(echo "$arm" | tr / _)" "$@"; do
    case $name in
    '' | *[!A-Za-z0-9_]*)
        echo "make_keystore.sh: '$name' is no name of an arm or a joint; expected letters, digits and _" >&2
        exit 2
        ;;
    esac
done
policies=$(ros2 pkg prefix --share posor_bringup)/security
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# write_policies JOINT: write all policies with the names of this arm and joint, and with the content of included files:
# sros2 crashes on nested includes (lxml 4.9 to 6.1)
write_policies() {
    for file in "$policies"/*.xml; do
        sed -e "s|{arm}|$arm|g" -e "s/{joint}/$1/g" "$file" >"$work/$(basename "$file")"
    done
    python3 -c '
import sys
from xml.etree import ElementInclude, ElementTree
for path in sys.argv[1:]:
    tree = ElementTree.parse(path)
    ElementInclude.include(tree.getroot(), base_url=path)
    tree.write(path, encoding="UTF-8", xml_declaration=True)
' "$work"/*.policy.xml
}

# add_enclave ENCLAVE EXECUTABLE: create an enclave with the permissions of an executable
add_enclave() {
    [ -f "$keystore/enclaves$1/key.pem" ] || ros2 security create_enclave "$keystore" "$1"
    ros2 security create_permission "$keystore" "$1" "$work/$2.policy.xml"
}

[ -f "$keystore/public/ca.cert.pem" ] || ros2 security create_keystore "$keystore"
for joint in "$@"; do
    write_policies "$joint"
    add_enclave "/$arm/$joint/posor_node" posor_node
    add_enclave "/$arm/$joint/driver_node" driver_node
done
write_policies '*' # these processes have to do with all joints
add_enclave "/$arm/chain_node" chain_node
add_enclave "/$arm/compose" compose
add_enclave "/$arm/commission" commission
add_enclave "/$arm/record" record

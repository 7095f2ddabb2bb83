#!/bin/busybox sh
# The guest's first program: mounts the host's file system as a read-only root, with a file system in
# memory over it that holds everything that the guest writes.
B=/bin/busybox
give_up() { echo "guest: $1"; $B poweroff -f; }

$B mount -t proc proc /proc
$B mount -t sysfs sysfs /sys
$B mount -t devtmpfs devtmpfs /dev
for module in $($B cat /modules/order); do
    $B insmod "/modules/$module" || give_up "the module $module cannot be inserted"
done
$B mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288,cache=loose,ro host /host \
    || give_up "the host's file system cannot be mounted"
$B mount -t tmpfs tmpfs /written
$B mkdir /written/upper /written/work
$B mount -t overlay -o lowerdir=/host,upperdir=/written/upper,workdir=/written/work overlay /root \
    || give_up "the overlay over the host's file system cannot be mounted"
$B mkdir -p /root/mnt/exchange
$B mount -t 9p -o trans=virtio,version=9p2000.L,cache=none exchange /root/mnt/exchange \
    || give_up "the folder for the exchange with the host cannot be mounted"
for folder in proc sys dev; do $B mount --move "/$folder" "/root/$folder"; done
exec $B switch_root /root /bin/sh /mnt/exchange/second_program.sh

// SPDX-License-Identifier: GPL-2.0-only
/*
 * For tests only: a CAN controller goes bus-off, as its driver would report it.
 *
 *   echo can0 > /sys/module/can_bus_off/parameters/interface
 *
 * An emulated controller never meets an error on the wire. What follows is the kernel's own: error frame, state,
 * carrier, and the restart after restart-ms or by hand. Like a controller that is bus-off, the interface then hears
 * nothing, until its restart.
 */
#include <linux/can/dev.h>
#include <linux/can/error.h>
#include <linux/if_arp.h>
#include <linux/module.h>
#include <linux/netdevice.h>
#include <linux/rtnetlink.h>

/* Away with the data frames of an interface that is bus-off; other frames pass. */
static rx_handler_result_t hear(struct sk_buff **arrived)
{
	struct sk_buff *frame = *arrived;
	struct can_priv *controller = netdev_priv(frame->dev);

	if (controller->state != CAN_STATE_BUS_OFF)
		return RX_HANDLER_PASS;
	if (((struct can_frame *)frame->data)->can_id & CAN_ERR_FLAG)
		return RX_HANDLER_PASS;
	kfree_skb(frame);
	return RX_HANDLER_CONSUMED;
}

static int go_bus_off(struct net_device *device)
{
	struct can_priv *controller = netdev_priv(device);
	struct can_frame *content;
	struct sk_buff *frame;
	int error;

	if (!netif_running(device))
		return -ENETDOWN;
	if (controller->state == CAN_STATE_BUS_OFF)
		return -EALREADY;
	if (!netdev_is_rx_handler_busy(device)) {
		error = netdev_rx_handler_register(device, hear, NULL);
		if (error)
			return error;
	}
	frame = alloc_can_err_skb(device, &content);
	if (!frame)
		return -ENOMEM;
	can_change_state(device, content, CAN_STATE_BUS_OFF, CAN_STATE_BUS_OFF);
	can_bus_off(device);
	netif_rx(frame);
	return 0;
}

static int interface_set(const char *text, const struct kernel_param *parameter)
{
	char name[IFNAMSIZ];
	struct net_device *device;
	int error = -ENODEV;

	if (strscpy(name, text, sizeof(name)) < 0)
		return -EINVAL;
	rtnl_lock();
	device = __dev_get_by_name(&init_net, strim(name));
	/* Only devices made by alloc_candev() have a can_priv. */
	if (device && device->type == ARPHRD_CAN && device->dev.parent)
		error = go_bus_off(device);
	rtnl_unlock();
	return error;
}

static const struct kernel_param_ops interface_ops = { .set = interface_set };
module_param_cb(interface, &interface_ops, NULL, 0200);
MODULE_PARM_DESC(interface, "CAN interface that goes bus-off when its name is written here");

static int __init can_bus_off_init(void)
{
	return 0;
}

/* Interfaces may still be watched by hear(), so there is no way out: without an exit function it cannot be unloaded. */
module_init(can_bus_off_init);
MODULE_DESCRIPTION("Lets a CAN controller go bus-off, for tests");
MODULE_LICENSE("GPL");

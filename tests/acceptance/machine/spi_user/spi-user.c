// SPDX-License-Identifier: GPL-2.0-only
/*
 * For tests only: an SPI port and a data-ready line behind which a user process is the device.
 *
 * The kernel's own spidev and GPIO character devices stand in front, so that a program under test meets the real
 * interfaces. Two devices lead to the process that plays the part:
 *
 *   /dev/spi-user     read() gives one transfer, write() its answer; at most one is under way
 *   /dev/data-ready   each byte written, '0' or '1', is the level of GPIO line 0 from then on
 *
 * Without a process at /dev/spi-user transfers fail with EIO, without an answer in time with ETIMEDOUT.
 */
#include <linux/gpio/driver.h>
#include <linux/irq_work.h>
#include <linux/miscdevice.h>
#include <linux/module.h>
#include <linux/mutex.h>
#include <linux/platform_device.h>
#include <linux/poll.h>
#include <linux/spi/spi.h>
#include <linux/uaccess.h>

static unsigned int timeout_ms = 5000;
module_param(timeout_ms, uint, 0644);
MODULE_PARM_DESC(timeout_ms, "how long a transfer waits for its answer");

/* As the process reads it, followed by the bytes sent; native byte order. */
struct question {
	u64 asked_ns; /* CLOCK_MONOTONIC */
	u32 number;
	u32 length;
	u32 speed_hz;
	u8 mode;
	u8 bits;
	u8 cs_change;
	u8 is_last; /* of its message */
};

/* As the process writes it, followed by the bytes received if the status is 0. */
struct answer {
	u32 number;
	s32 status; /* 0 or a negative error number */
};

static struct platform_device *platform;
static struct spi_controller *controller;

/* ---- SPI ---- */

static DEFINE_MUTEX(lock);
static DECLARE_WAIT_QUEUE_HEAD(asked);
static DECLARE_WAIT_QUEUE_HEAD(answered);
static bool is_served;
static struct question question;
static struct spi_transfer *under_way; /* NULL: none, or answered */
static bool is_read;
static int status;

static bool is_waiting(void)
{
	return READ_ONCE(under_way) && !READ_ONCE(is_read);
}

static int transfer_one(struct spi_controller *ctlr, struct spi_device *spi, struct spi_transfer *transfer)
{
	mutex_lock(&lock);
	if (!is_served) {
		mutex_unlock(&lock);
		return -EIO;
	}
	question.asked_ns = ktime_get_ns();
	question.number++;
	question.length = transfer->len;
	question.speed_hz = transfer->speed_hz;
	question.mode = spi->mode;
	question.bits = transfer->bits_per_word;
	question.cs_change = transfer->cs_change;
	question.is_last = spi_transfer_is_last(ctlr, transfer);
	is_read = false;
	under_way = transfer;
	mutex_unlock(&lock);
	wake_up(&asked);

	wait_event_timeout(answered, !READ_ONCE(under_way), msecs_to_jiffies(timeout_ms));

	mutex_lock(&lock);
	if (under_way) {
		under_way = NULL;
		status = -ETIMEDOUT;
	}
	mutex_unlock(&lock);
	return status;
}

static int server_open(struct inode *inode, struct file *file)
{
	int error = 0;

	mutex_lock(&lock);
	if (is_served)
		error = -EBUSY;
	is_served = true;
	mutex_unlock(&lock);
	return error;
}

static int server_release(struct inode *inode, struct file *file)
{
	mutex_lock(&lock);
	is_served = false;
	if (under_way) {
		status = -EIO;
		under_way = NULL;
	}
	mutex_unlock(&lock);
	wake_up(&answered);
	return 0;
}

static ssize_t server_read(struct file *file, char __user *buffer, size_t size, loff_t *offset)
{
	ssize_t result;

	if (!is_waiting() && (file->f_flags & O_NONBLOCK))
		return -EAGAIN;
	if (wait_event_interruptible(asked, is_waiting()))
		return -ERESTARTSYS;
	mutex_lock(&lock);
	if (!is_waiting()) {
		result = -EAGAIN; /* given up meanwhile */
	} else if (size < sizeof(question) + under_way->len) {
		result = -EMSGSIZE;
	} else {
		result = sizeof(question) + under_way->len;
		if (copy_to_user(buffer, &question, sizeof(question)))
			result = -EFAULT;
		else if (under_way->tx_buf) {
			if (copy_to_user(buffer + sizeof(question), under_way->tx_buf, under_way->len))
				result = -EFAULT;
		} else if (clear_user(buffer + sizeof(question), under_way->len)) {
			result = -EFAULT;
		}
		is_read = result > 0;
	}
	mutex_unlock(&lock);
	return result;
}

static ssize_t server_write(struct file *file, const char __user *buffer, size_t size, loff_t *offset)
{
	struct answer answer;
	ssize_t result = size;

	if (size < sizeof(answer))
		return -EINVAL;
	if (copy_from_user(&answer, buffer, sizeof(answer)))
		return -EFAULT;
	mutex_lock(&lock);
	if (!under_way || !is_read || answer.number != question.number) {
		result = -ESTALE; /* too late */
	} else if (answer.status > 0 || (!answer.status && size != sizeof(answer) + under_way->len)) {
		result = -EINVAL;
	} else if (!answer.status && under_way->rx_buf &&
		   copy_from_user(under_way->rx_buf, buffer + sizeof(answer), under_way->len)) {
		result = -EFAULT;
	} else {
		status = answer.status;
		under_way = NULL;
	}
	mutex_unlock(&lock);
	wake_up(&answered);
	return result;
}

static __poll_t server_poll(struct file *file, poll_table *table)
{
	poll_wait(file, &asked, table);
	return EPOLLOUT | EPOLLWRNORM | (is_waiting() ? EPOLLIN | EPOLLRDNORM : 0);
}

static const struct file_operations server_operations = {
	.owner = THIS_MODULE,
	.open = server_open,
	.release = server_release,
	.read = server_read,
	.write = server_write,
	.poll = server_poll,
	.llseek = noop_llseek,
};

static struct miscdevice server = {
	.minor = MISC_DYNAMIC_MINOR,
	.name = "spi-user",
	.fops = &server_operations,
};

/* ---- The data-ready line ---- */

static struct gpio_chip chip;
static struct irq_work edge;
static DEFINE_MUTEX(level_lock);
static int level = 1;
static unsigned int trigger;

static int line_direction(struct gpio_chip *gc, unsigned int offset)
{
	return GPIO_LINE_DIRECTION_IN;
}

static int line_direction_input(struct gpio_chip *gc, unsigned int offset)
{
	return 0;
}

static int line_get(struct gpio_chip *gc, unsigned int offset)
{
	return READ_ONCE(level);
}

static void line_mask(struct irq_data *data)
{
	gpiochip_disable_irq(&chip, irqd_to_hwirq(data));
}

static void line_unmask(struct irq_data *data)
{
	gpiochip_enable_irq(&chip, irqd_to_hwirq(data));
}

static int line_set_type(struct irq_data *data, unsigned int type)
{
	if (type & IRQ_TYPE_LEVEL_MASK)
		return -EINVAL;
	WRITE_ONCE(trigger, type);
	return 0;
}

static const struct irq_chip line_irq = {
	.name = "data-ready",
	.irq_mask = line_mask,
	.irq_unmask = line_unmask,
	.irq_set_type = line_set_type,
	.flags = IRQCHIP_IMMUTABLE,
	GPIOCHIP_IRQ_RESOURCE_HELPERS,
};

/* In interrupt context, as an edge is seen on a real chip. */
static void on_edge(struct irq_work *work)
{
	generic_handle_domain_irq(chip.irq.domain, 0);
}

static ssize_t level_write(struct file *file, const char __user *buffer, size_t size, loff_t *offset)
{
	size_t i;

	for (i = 0; i < size; i++) {
		char wanted;
		bool changes;

		if (get_user(wanted, buffer + i))
			return -EFAULT;
		if (wanted != '0' && wanted != '1')
			return -EINVAL;
		mutex_lock(&level_lock);
		changes = level != wanted - '0';
		WRITE_ONCE(level, wanted - '0');
		if (changes && (READ_ONCE(trigger) & (level ? IRQ_TYPE_EDGE_RISING : IRQ_TYPE_EDGE_FALLING))) {
			irq_work_queue(&edge);
			irq_work_sync(&edge);
		}
		mutex_unlock(&level_lock);
	}
	return size;
}

static const struct file_operations level_operations = {
	.owner = THIS_MODULE,
	.write = level_write,
	.llseek = noop_llseek,
};

static struct miscdevice level_device = {
	.minor = MISC_DYNAMIC_MINOR,
	.name = "data-ready",
	.fops = &level_operations,
};

static int add_line(void)
{
	chip.label = "spi-user";
	chip.parent = &platform->dev;
	chip.owner = THIS_MODULE;
	chip.base = -1;
	chip.ngpio = 1;
	chip.get_direction = line_direction;
	chip.direction_input = line_direction_input;
	chip.get = line_get;
	gpio_irq_chip_set_chip(&chip.irq, &line_irq);
	chip.irq.handler = handle_simple_irq;
	chip.irq.default_type = IRQ_TYPE_NONE;
	init_irq_work(&edge, on_edge);
	return gpiochip_add_data(&chip, NULL);
}

/* ---- The module ---- */

static int add_port(void)
{
	/* One of the names that the kernel's spidev knows. */
	struct spi_board_info device = { .modalias = "spi-petra", .max_speed_hz = 10000000, .mode = SPI_MODE_0 };
	int error;

	controller = spi_alloc_master(&platform->dev, 0);
	if (!controller)
		return -ENOMEM;
	controller->bus_num = 0;
	controller->num_chipselect = 1;
	controller->mode_bits = SPI_CPOL | SPI_CPHA | SPI_CS_HIGH | SPI_LSB_FIRST;
	controller->bits_per_word_mask = SPI_BPW_MASK(8) | SPI_BPW_MASK(16);
	controller->transfer_one = transfer_one;
	error = spi_register_controller(controller);
	if (error) {
		spi_controller_put(controller);
		return error;
	}
	if (!spi_new_device(controller, &device)) {
		spi_unregister_controller(controller);
		return -ENODEV;
	}
	return 0;
}

static int __init spi_user_init(void)
{
	int error;

	platform = platform_device_register_simple("spi-user", -1, NULL, 0);
	if (IS_ERR(platform))
		return PTR_ERR(platform);
	error = add_line();
	if (error)
		goto no_line;
	error = misc_register(&level_device);
	if (error)
		goto no_level;
	error = misc_register(&server);
	if (error)
		goto no_server;
	error = add_port();
	if (error)
		goto no_port;
	return 0;
no_port:
	misc_deregister(&server);
no_server:
	misc_deregister(&level_device);
no_level:
	gpiochip_remove(&chip);
no_line:
	platform_device_unregister(platform);
	return error;
}

static void __exit spi_user_exit(void)
{
	spi_unregister_controller(controller);
	misc_deregister(&server);
	misc_deregister(&level_device);
	gpiochip_remove(&chip);
	platform_device_unregister(platform);
}

module_init(spi_user_init);
module_exit(spi_user_exit);
MODULE_DESCRIPTION("SPI port and data-ready line played by a user process, for tests");
MODULE_LICENSE("GPL");
